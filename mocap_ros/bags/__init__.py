"""Recordings: write, read and recover MCAP files and rosbag2 bags."""
