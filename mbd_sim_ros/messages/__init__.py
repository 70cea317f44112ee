"""Snapshots as ROS messages, in bytes."""
