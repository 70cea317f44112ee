"""What is computed with finished models and simulations."""
