"""Maneuvers judged by their norms: figures, limits and verdicts from recordings. One file per family of norms,
registry.py lists them."""
