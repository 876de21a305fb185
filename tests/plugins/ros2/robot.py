"""Another program on a domain of ROS 2, in the test's own process: nobody on the network hears it."""

from __future__ import annotations

import gc
import math
import os
from typing import Any

import pytest

from edge_plugins.ros2.messages import message_types

pytest.importorskip("cyclonedds", reason="the extra ros2 is not installed")
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

QUIET = """<CycloneDDS><Domain><General><Interfaces><NetworkInterface name="lo" multicast="false"/></Interfaces>
<AllowMulticast>false</AllowMulticast></General></Domain></CycloneDDS>"""


class RosClock:
    """CLOCK_MONOTONIC, moved by the test, and the time of ROS 2."""

    def __init__(self) -> None:
        self.now_ns = 10**12

    def __call__(self) -> int:
        return self.now_ns

    def unix_ns(self) -> int:
        return 1_700_000_000 * 10**9 + self.now_ns


class Robot:
    """Hears what Lookback publishes, and sends odometry."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv("CYCLONEDDS_URI", QUIET)
        self.domain = 100 + os.getpid() % 100
        self._participant = DomainParticipant(self.domain)
        self._readers: dict[str, Any] = {}
        self._writer: Any = None

    def _topic(self, name: str, kind: str) -> Any:
        return Topic(self._participant, f"rt/{name}", message_types()[kind])

    def listen(self, name: str, kind: str) -> None:
        """As `ros2 topic echo` does."""
        reliable = Qos(Policy.Reliability.Reliable(10**9), Policy.History.KeepLast(100))
        self._readers[name] = DataReader(self._participant, self._topic(name, kind), qos=reliable)

    def heard(self, name: str) -> list[Any]:
        """The messages since the last call."""
        return list(self._readers[name].take(100))

    def send_odometry(
        self, stamp_ns: int, ahead_mps: float, left_mps: float = 0.0, *, yaw_rad: float = 0.0, variance: float = 0.01
    ) -> None:
        """To /odometry; stamp_ns: of ROS 2. yaw_rad: counterclockwise from the frame's x."""
        kinds = message_types()
        header = kinds["std_msgs/Header"](kinds["builtin_interfaces/Time"](*divmod(stamp_ns, 10**9)), "odom")
        turned = kinds["geometry_msgs/Quaternion"](0.0, 0.0, math.sin(yaw_rad / 2), math.cos(yaw_rad / 2))
        pose = kinds["geometry_msgs/Pose"](kinds["geometry_msgs/Point"](1.0, 2.0, 3.0), turned)
        moves, turns = kinds["geometry_msgs/Vector3"](ahead_mps, left_mps, 0.0), kinds["geometry_msgs/Vector3"](0, 0, 0)
        twist = kinds["geometry_msgs/TwistWithCovariance"](
            kinds["geometry_msgs/Twist"](moves, turns), [variance] + [0.0] * 35
        )
        if self._writer is None:
            self._writer = DataWriter(self._participant, self._topic("odometry", "nav_msgs/Odometry"))
        at = kinds["geometry_msgs/PoseWithCovariance"](pose, [0.0] * 36)
        self._writer.write(kinds["nav_msgs/Odometry"](header, "base_link", at, twist))

    def leave(self) -> None:
        """Odometry comes no more."""
        self._writer = None
        gc.collect()
