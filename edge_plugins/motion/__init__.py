"""The vehicle's own motion from the ground that its camera shows: forward speed and turn, without wheels or GPS.

`ground` measures it between two pictures, in heights of the camera; `camera_motion` says when the ground cannot be
seen; `height` learns that height from GPS, and from places where there is none. `velocity_sender` is for the autopilot.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from msgspec import Meta

from edge.config import Config, Section


class MotionConfig(Section, frozen=True):
    """[motion]: the vehicle's speed from the ground that [camera] shows."""

    plugin: ClassVar[str] = "edge_plugins.motion.plugin:Motion"
    use: Literal["off", "report", "odometer", "send"] = "off"
    pitch_deg: Annotated[float, Meta(ge=-20, le=90)] = 0.0

    def asks(self, config: Config) -> bool:
        """Where the speed is used."""
        if self.use != "off":
            config.camera.known_fov_deg("[motion] needs it")
        return self.use != "off"
