"""Recordings: MCAP and rosbag2 bags written, read and repaired."""
