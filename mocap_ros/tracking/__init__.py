"""Tracking of people in 3D, frame by frame: a sliding window and a solution for each person."""
