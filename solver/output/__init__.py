"""What a run shows: snapshots, the energy account, dependence of constraints, branches."""
