"""Rotations, lens distortion and camera models; nothing here depends on the human body."""
