"""ROS messages to and from CDR bytes, a file a message; no ROS installation is needed."""
