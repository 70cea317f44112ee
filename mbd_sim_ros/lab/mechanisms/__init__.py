"""Mechanisms drawn at random, by family, and what becomes of them when they are run with the defaults."""
