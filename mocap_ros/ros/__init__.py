"""The live side: the lifecycle node and the player. Only this package imports rclpy."""
