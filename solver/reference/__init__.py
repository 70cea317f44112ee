"""Independent integrators of the same models, slow and careful."""
