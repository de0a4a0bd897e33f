"""Readers of motion-capture files, for training."""
