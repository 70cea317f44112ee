"""Analyses of finished models and simulations."""
