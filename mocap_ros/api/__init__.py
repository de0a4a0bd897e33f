"""The public Python API: NumPy arrays in, results out. `mocap_ros/__init__.py` exports it."""
