"""Scenes without Python: kernels as a shared library, models as files for it, and units of co-simulation (FMI)."""
