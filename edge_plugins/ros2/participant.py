"""One DDS participant as a node of ROS 2 would be; nothing in here blocks, and no thread is ours."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from edge.backoff import BackOff
from edge.geodesy import Origin, east_north_of
from edge.journal.records import PlaceFix
from edge_plugins.ros2 import Ros2Config
from edge_plugins.ros2.messages import message_types

STATE_NS = 1_000_000_000  # between two states, as diagnostics are sent elsewhere
AGAIN_FIRST_NS, AGAIN_LAST_NS = 1_000_000_000, 60_000_000_000  # between attempts to open a network that is not up yet
KEPT_SAMPLES = 10  # messages, as the default profile of ROS 2 keeps
UNKNOWN = 1e6
"""Variance of what is not measured (height, roll, pitch): who fuses it all the same learns nothing."""
YAW_SIGMA_RAD = math.radians(60) / math.sqrt(3)
"""A place is used up to 60 degrees between the road and the way that the vehicle goes: anything within is as likely."""
LATEST_NS = 1_000_000_000
"""Odometry that is older, or ahead by so much, has another clock: nobody knows when it was true."""
MOST_SIGMA_MPS = 1.0  # a source that states more has lost itself
COVARIANCE_KNOWN, OK, WARN, ERROR = 3, 0, 1, 2
LEVELS = {"off the map": WARN, "degraded": ERROR, "failed": ERROR}
log = logging.getLogger(__name__)


class OdometryReport(NamedTuple):
    """Of another program, at `stamp_ns` (CLOCK_MONOTONIC): ahead and to the left, in m/s.

    yaw_rad: of its pose, counterclockwise from east; None where its frame is not aligned with north.
    """

    stamp_ns: int
    ahead_mps: float
    left_mps: float
    yaw_rad: float | None


class Ros2:
    """Publishes what was recognized, and hears the odometry that [ros2] names."""

    def __init__(
        self,
        config: Ros2Config,
        clock_ns: Callable[[], int],
        unix_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        """ConfigError without the package. unix_ns: the time of ROS 2."""
        self._types, self._config = message_types(), config
        self._clock_ns, self._unix_ns = clock_ns, unix_ns
        self.datum: Origin | None = None
        """Where the map frame's origin is; None: no pose is published."""
        self._back_off = BackOff(AGAIN_FIRST_NS, AGAIN_LAST_NS)
        self._participant: Any = None
        self._writers: dict[str, Any] = {}
        self._reader: Any = None
        self._state_due_ns = 0
        self._warned: set[str] = set()
        self.published_ns: int | None = None
        """When the newest position was published."""
        self.judged_ns = 0
        """The exposure of the newest position of which it was decided whether to publish it."""

    def _open(self) -> bool:
        """Open what is not open, if it is time to try; whether all is open."""
        now_ns, config = self._clock_ns(), self._config
        if self._participant is not None or not self._back_off.is_over(now_ns):
            return self._participant is not None
        from cyclonedds.core import DDSException, Policy, Qos
        from cyclonedds.domain import DomainParticipant
        from cyclonedds.pub import DataWriter
        from cyclonedds.sub import DataReader
        from cyclonedds.topic import Topic

        kept, version = Policy.History.KeepLast(KEPT_SAMPLES), Policy.DataRepresentation(use_cdrv0_representation=True)
        # Without a moment's wait: a reader that hangs must not hold up the recognizer.
        sent, heard = Qos(Policy.Reliability.Reliable(0), kept, version), Qos(Policy.Reliability.BestEffort, kept)
        kinds = dict.fromkeys(("place", "pose"), self._types["geometry_msgs/PoseWithCovarianceStamped"])
        kinds["fix"] = self._types["sensor_msgs/NavSatFix"]
        topics = {name: (f"rt/{config.namespace}/{name}", kind) for name, kind in kinds.items()}
        topics["state"] = "rt/diagnostics", self._types["diagnostic_msgs/DiagnosticArray"]
        try:
            participant = DomainParticipant(config.domain)
            for name, topic in topics.items():
                self._writers[name] = DataWriter(participant, Topic(participant, *topic), qos=sent)
            if config.odometry:
                name, kind = f"rt/{config.odometry.strip('/')}", self._types["nav_msgs/Odometry"]
                self._reader = DataReader(participant, Topic(participant, name, kind), qos=heard)
        except DDSException as error:
            self._back_off.failed(now_ns)
            self._warn(f"ROS 2: domain {config.domain} cannot be opened, trying again: {error.msg}")
            return False
        self._participant = participant
        log.info(
            "ROS 2: domain %d, /%s; origin of %s: %s", config.domain, config.namespace, config.map_frame, self.datum
        )
        return True

    def _warn(self, text: str) -> None:
        """Once."""
        if text not in self._warned:
            self._warned.add(text)
            log.warning("%s", text)

    def close(self) -> None:
        """Leave the domain; more than once is harmless, and anything that follows would open it again."""
        self._participant, self._reader = None, None
        self._writers.clear()

    def publish_place(self, fix: PlaceFix) -> None:
        """A recognized place, which no condition has passed yet but that it is believed."""
        self._publish_pose("place", fix)

    def publish_position(self, fix: PlaceFix) -> None:
        """A position that may be published."""
        self.published_ns = self._clock_ns()
        if fix.lat_deg is None or fix.lon_deg is None:
            return
        self._publish_pose("pose", fix)
        (east, north), both = _variances(fix)
        covariance = [east, both, 0.0, both, north, 0.0, 0.0, 0.0, UNKNOWN]
        status = self._types["sensor_msgs/NavSatStatus"](status=0, service=0)
        header = self._header(fix.stamp_ns, self._config.base_frame)
        values = header, status, fix.lat_deg, fix.lon_deg, math.nan, covariance, COVARIANCE_KNOWN
        self._write("fix", self._types["sensor_msgs/NavSatFix"](*values))

    def publish_state(self, state: str, why: str, link: Callable[[], object]) -> None:
        """The daemon's state, once a second; link: makes a record of what is known of the autopilot."""
        now_ns = self._clock_ns()
        if now_ns < self._state_due_ns:
            return
        self._state_due_ns = now_ns + STATE_NS
        pair = self._types["diagnostic_msgs/KeyValue"]
        pairs = [pair(key, str(value)) for key, value in vars(link()).items() if value not in (None, "")]
        words = f"{state}: {why}" if why else state
        kind = self._types["diagnostic_msgs/DiagnosticStatus"]
        status = kind(LEVELS.get(state, OK), f"{self._config.namespace}: places", words, "lookback", pairs)
        header = self._header(now_ns, "")
        self._write("state", self._types["diagnostic_msgs/DiagnosticArray"](header, [status]))

    def odometry(self) -> Iterator[OdometryReport]:
        """What has arrived since the last call, oldest first; what is damaged or of another clock is ignored."""
        if not (self._open() and self._reader is not None):
            return
        behind_ns = self._unix_ns() - self._clock_ns()
        for message in self._reader.take(KEPT_SAMPLES):
            if not message.sample_info.valid_data:  # a publisher has left
                continue
            stamp, twist = message.header.stamp, message.twist.twist.linear
            stamp_ns = stamp.sec * 10**9 + stamp.nanosec - behind_ns
            turn = message.pose.pose.orientation
            yaw_rad = math.atan2(2 * (turn.w * turn.z + turn.x * turn.y), 1 - 2 * (turn.y**2 + turn.z**2))
            if not all(map(math.isfinite, (twist.x, twist.y, yaw_rad))):
                self._warn("ROS 2: odometry that is not a number is ignored")
            elif abs(self._clock_ns() - stamp_ns) > LATEST_NS:
                self._warn("ROS 2: odometry is ignored: its stamps are over a second off this computer's clock")
            elif not message.twist.covariance[0] > MOST_SIGMA_MPS**2:
                yield OdometryReport(stamp_ns, twist.x, twist.y, yaw_rad if self._config.odometry_is_enu else None)

    def _publish_pose(self, name: str, fix: PlaceFix) -> None:
        """In the map's frame: meters east and north of the datum."""
        if self.datum is None or fix.lat_deg is None or fix.lon_deg is None:
            return
        types, (east_m, north_m) = self._types, east_north_of(fix.lat_deg, fix.lon_deg, self.datum)
        (east, north), both = _variances(fix)
        half_rad = math.radians(90 - (fix.heading_deg or 0.0)) / 2
        yaw = UNKNOWN if fix.heading_deg is None else YAW_SIGMA_RAD**2
        covariance = [0.0] * 36
        for at, variance in enumerate((east, north, UNKNOWN, UNKNOWN, UNKNOWN, yaw)):
            covariance[7 * at] = variance
        covariance[1] = covariance[6] = both
        turned = types["geometry_msgs/Quaternion"](0.0, 0.0, math.sin(half_rad), math.cos(half_rad))
        pose = types["geometry_msgs/Pose"](types["geometry_msgs/Point"](east_m, north_m, 0.0), turned)
        uncertain = types["geometry_msgs/PoseWithCovariance"](pose, covariance)
        header = self._header(fix.stamp_ns, self._config.map_frame)
        self._write(name, types["geometry_msgs/PoseWithCovarianceStamped"](header, uncertain))

    def _header(self, stamp_ns: int, frame: str) -> Any:
        unix_ns = self._unix_ns() - self._clock_ns() + stamp_ns
        return self._types["std_msgs/Header"](self._types["builtin_interfaces/Time"](*divmod(unix_ns, 10**9)), frame)

    def _write(self, name: str, message: Any) -> None:
        if not self._open():
            return
        from cyclonedds.core import DDSException

        try:
            self._writers[name].write(message)
        except DDSException as error:
            self._warn(f"ROS 2: {name} is lost: {error.msg}")


def _variances(fix: PlaceFix) -> tuple[tuple[float, float], float]:
    """East and north, and their covariance, from standard deviations along and across the road."""
    along, across = fix.sigma_along_m**2, fix.sigma_cross_track_m**2
    if fix.heading_deg is None:
        return (max(along, across), max(along, across)), 0.0
    sin, cos = math.sin(math.radians(fix.heading_deg)), math.cos(math.radians(fix.heading_deg))
    return (along * sin**2 + across * cos**2, along * cos**2 + across * sin**2), (along - across) * sin * cos
