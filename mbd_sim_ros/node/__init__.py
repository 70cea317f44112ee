"""The ROS 2 node."""

PREPARING = 'preparing'  # the thread that ~/load has for it
