"""From a specification to a state from which every step is second order."""
