"""Training of the lifter: needs PyTorch (`pip install mocap_ros[train]`); what is trained does not."""
