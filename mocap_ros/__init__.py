"""People in 3D from one uncalibrated camera and a 2D keypoint detector.

`geometry`, `keypoints`, `models`, `solvers`, `tracking` and `offline` hold the mathematics and know no messages,
bags or file formats. `messages`, `bags` and `formats` read and write them. `runtime` joins the two sides, `ros` is
the only folder that imports rclpy, and `cli` has the commands. docs/architecture.md explains the folders.
"""
