"""Other programs that the same problems are given to."""
