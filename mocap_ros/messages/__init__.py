"""ROS messages to and from CDR bytes, with one file for each message; no ROS installation is needed."""
