"""Trained models and their files: base poses, lifter, motion predictor, velocity correction; joint deviations."""
