"""Places, positions and state for ROS 2, and odometry from there, by DDS; `messages` has the types of ROS 2.

Report only: nothing here goes to an autopilot but by the distance driven, where nothing else measures a speed.
"""

from __future__ import annotations

from typing import Annotated, ClassVar

from msgspec import Meta

from edge.config import Config, Section


class Ros2Config(Section, frozen=True):
    """[ros2]: what is published to ROS 2 by DDS, and whose odometry is used; off while domain is -1."""

    plugin: ClassVar[str] = "edge_plugins.ros2.plugin:Ros2Plugin"
    domain: Annotated[int, Meta(ge=-1, le=232)] = -1
    namespace: Annotated[str, Meta(pattern="^[A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*)*$")] = "lookback"
    map_frame: str = "map"
    base_frame: str = "base_link"
    odometry: Annotated[str, Meta(pattern="^$|^/?[A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*)*$")] = ""
    odometry_is_enu: bool = False

    def asks(self, config: Config) -> bool:
        """Where there is a domain."""
        return self.domain >= 0
