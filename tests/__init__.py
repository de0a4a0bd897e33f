"""Tests, in the folders of the package; what several of them share is in `support`."""
