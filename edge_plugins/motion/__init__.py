"""The vehicle's own motion from the ground that its camera shows: forward speed and turn, without wheels or GPS.

`ground` measures it between two pictures, in heights of the camera; `camera_motion` says when the ground cannot be
seen; `height` learns that height from GPS, and from places where there is none. `velocity_sender` is for the autopilot.
"""

from __future__ import annotations

from edge_plugins.motion.camera_motion import CameraMotion, CameraSpeed
from edge_plugins.motion.height import PassedLine

__all__ = ["CameraMotion", "CameraSpeed", "PassedLine"]
