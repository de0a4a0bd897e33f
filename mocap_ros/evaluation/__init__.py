"""Errors of a reconstruction against the truth."""
