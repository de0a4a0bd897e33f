"""People in 3D from one uncalibrated camera and a 2D keypoint detector.

The maths (`skeleton`, `base_poses`, `camera`, `alternation`, `tracker`, `metrics`) knows no ROS, no files
and no printing; `io` reads and writes files and messages; only `ros` imports rclpy.
"""
