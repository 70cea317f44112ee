"""Everything that drives a model from outside, as functions of time or of what a driver sees."""
