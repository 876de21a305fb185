"""Places, positions and state for ROS 2, and odometry from there, by DDS; `messages` has the types of ROS 2.

Report only: nothing here goes to an autopilot but by the distance driven, where nothing else measures a speed.
"""

from __future__ import annotations

from edge_plugins.ros2.participant import OdometryReport, Ros2

__all__ = ["OdometryReport", "Ros2"]
