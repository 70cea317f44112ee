"""Studies and benchmarks: what measures the rest."""
