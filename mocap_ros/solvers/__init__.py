"""From a window of keypoints to 3D poses and cameras."""
