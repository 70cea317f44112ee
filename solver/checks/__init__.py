"""Checks that make a run suspect: one record for each, listed in solver.checks.registry (docs/contributing.md, "A
check")."""
