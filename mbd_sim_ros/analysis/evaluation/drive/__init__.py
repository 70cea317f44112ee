"""Ordinary drives judged: figures of a car from any recording, each with its interval or the reason why the drive does
not tell it. judging.py collects them; one file per family of figures."""
