"""Files that are not bags."""
