"""Variants of the solvers that only the experiments with the paper use."""
