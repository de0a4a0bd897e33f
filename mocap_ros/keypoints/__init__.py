"""People in 2D: what one is, whether their keypoints can be used, who is who, left and right."""
