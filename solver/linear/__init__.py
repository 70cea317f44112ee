"""Linear algebra on the block pattern of a model."""
