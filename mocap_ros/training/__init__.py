"""Training of base poses and of the lifter; only the lifter's needs PyTorch (`pip install mocap_ros[train]`)."""
