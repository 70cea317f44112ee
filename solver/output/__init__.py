"""Outputs of a run: snapshots, the energy account, dependence of constraints, branches."""
