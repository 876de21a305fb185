"""The vehicle's own motion from the ground that its camera shows: forward speed and turn, without wheels or GPS.

`ground` measures it between two pictures, in heights of the camera; `camera_motion` learns that height while GPS is
good, and says when the ground cannot be seen.
"""

from __future__ import annotations

from edge.motion.camera_motion import CameraMotion, CameraSpeed

__all__ = ["CameraMotion", "CameraSpeed"]
