"""People, frame by frame."""
