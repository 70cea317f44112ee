"""Time integration: the augmented-Lagrangian step, and independent references."""
