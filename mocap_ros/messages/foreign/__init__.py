"""Readers of the messages of other packages' detectors, with one file for each package."""
