"""Run the package in ROS 2: the lifecycle node and the player. Only this package imports rclpy."""
