"""Numerics and models of mbd_sim_ros: no ROS, no messages."""

from solver import jit  # noqa: F401  (pins the compile cache before the first kernel is imported)
