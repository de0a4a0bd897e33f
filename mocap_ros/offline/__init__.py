"""One whole recording at a time."""
