"""[ros2] in the daemon: odometry from ROS 2, state, places and positions to it."""

from __future__ import annotations

from edge.geodesy import first_known
from edge.localization import Fix, FixRequest
from edge.plugin import Parts, Plugin, UsedFrame
from edge_plugins.ros2 import Ros2Config
from edge_plugins.ros2.participant import Ros2

OLDEST_S = 5.0  # of an exposure, as of a position for ArduPilot


class Ros2Plugin(Plugin):
    """Positions by the conditions for an autopilot without GPS: nothing is moved by them here."""

    def __init__(self, config: Ros2Config, parts: Parts) -> None:
        """ConfigError without the package."""
        self._parts = parts
        self._ros2 = Ros2(config, parts.clock_ns)

    def start(self) -> None:
        """The map frame's origin: that of positions, else the first place that has one."""
        origin, places = self._parts.config.telemetry.origin, self._parts.recognizer.map_set.places
        known = (origin[0], origin[1]) if origin else None
        self._ros2.datum = known or first_known(places["lat_deg"], places["lon_deg"])

    def frame_used(self, used: UsedFrame) -> None:
        """Publish a place."""
        if used.place is not None:
            self._ros2.publish_place(used.place)

    def turn(self, spare_s: float | None) -> None:
        """Use odometry, publish the state, and a position where there is a new one that may be published."""
        parts, ros2, health = self._parts, self._ros2, self._parts.health()
        vehicle = parts.autopilot.vehicle
        for odometry in ros2.odometry():
            vehicle.velocity.use_odometry(*odometry)
        ros2.publish_state(health.state, health.why, parts.autopilot.status)
        position = parts.drive.state.position
        if position is None or position.stamp_ns == ros2.judged_ns:
            return
        ros2.judged_ns, now_ns = position.stamp_ns, parts.clock_ns()
        if ros2.published_ns is not None and now_ns - ros2.published_ns < parts.config.gates.min_interval_s * 1e9:
            return
        unable = health.unable(parts.pictures.why_no_position)
        answer = parts.drive.fix(now_ns, FixRequest(oldest_s=OLDEST_S, moves_autopilot=False, unable=unable))
        if isinstance(answer, Fix):
            ros2.publish_position(answer.place)

    def close(self) -> None:
        """Leave the domain."""
        self._ros2.close()
