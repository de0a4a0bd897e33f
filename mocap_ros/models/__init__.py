"""What was learned, base poses and lifter, and the files it comes in."""
