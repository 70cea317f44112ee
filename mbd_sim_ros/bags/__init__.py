"""Recordings: MCAP files written, read and recovered."""
