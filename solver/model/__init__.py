"""Specification, compilation and state of a model."""
