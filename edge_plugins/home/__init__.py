"""Any taught road again, as a mission that an autopilot follows, and uploaded: the way home, or a route of the config.

`drive_line`    the positions of one drive of a map, as a line on the ground, and fewer points of it
`passes`        which pass of that drive the vehicle is on
`checks`        whether a vehicle can drive a way: gaps, jumps, turns, length
`route_search`  along drives from place to place, from one onto another where they meet
`route`         from the vehicle on along them, home by default, checked and simplified: -> RoutePlan; and that as items
                of a MAVLink mission, as ArduPilot or PX4 number them

These are pure. `home_requests` answers requests, which come by MAVLink;
`mission_transfer` uploads the mission, and `replaced_mission` keeps the one before. `plugin` is for the daemon.
"""

from __future__ import annotations

from typing import Annotated, ClassVar

from msgspec import Meta

from edge.config import Config, Section


class HomeConfig(Section, frozen=True):
    """[home]: the way home and other routes, as a mission for the autopilot; off by default."""

    plugin: ClassVar[str] = "edge_plugins.home.plugin:Home"
    enabled: bool = False
    turning_radius_m: Annotated[float, Meta(ge=0, le=1000)] = 6.0
    tolerance_m: Annotated[float, Meta(ge=0.05, le=10)] = 0.5
    speed_mps: Annotated[float, Meta(ge=0, le=50)] = 0.0
    altitude_m: Annotated[float, Meta(ge=0, le=1000)] = 0.0
    max_start_m: Annotated[float, Meta(gt=0, le=1000)] = 20.0
    max_gap_m: Annotated[float, Meta(gt=0, le=1000)] = 20.0
    max_sigma_m: Annotated[float, Meta(gt=0, le=1000)] = 5.0
    max_length_m: Annotated[float, Meta(gt=0, le=100_000)] = 20_000.0
    routes: tuple[Annotated[str, Meta(pattern=r"^\S+( +\S+)+$")], ...] = ()

    def asks(self, config: Config) -> bool:
        """Where it is enabled."""
        return self.enabled
