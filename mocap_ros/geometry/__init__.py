"""Rotations and cameras; knows no people."""
