"""What makes a run suspect: one record for each check, listed in solver.checks.registry (docs/contributing.md, "A
check")."""
