"""Motion capture files, read for training."""
