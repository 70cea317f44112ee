"""The ROS edge of the simulator: messages, recording, node. Only `node` and `maneuver_player` need rclpy."""
