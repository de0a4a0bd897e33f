"""People in 2D images: keypoints and their checks, association, and left-right swaps."""
