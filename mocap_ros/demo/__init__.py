"""The demo recording: synthetic, generated from trained base poses, with its truth."""
