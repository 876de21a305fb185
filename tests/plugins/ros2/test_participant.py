"""What goes to ROS 2 and comes from there: heard by another participant, and decoded by the messages of rosbags."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from edge.geodesy import east_north_of
from edge.journal.records import PlaceFix
from edge.telemetry import LinkStatus
from edge_plugins.ros2 import Ros2Config
from edge_plugins.ros2.messages import DEFINITIONS
from edge_plugins.ros2.participant import Ros2
from tests.plugins.ros2.robot import Robot, RosClock

rosbags = pytest.importorskip("rosbags.typesys", reason="the extra eval is not installed")
STORE = rosbags.get_typestore(rosbags.Stores.ROS2_JAZZY)
DATUM = (-27.0, 152.0)
FIX = PlaceFix(
    stamp_ns=10**12 - 400_000_000,
    place=3,
    lat_deg=-26.999,
    lon_deg=152.001,
    heading_deg=60.0,
    sigma_along_m=4.0,
    sigma_cross_track_m=2.0,
    direction="forward",
    order="same",
    uniqueness=1.2,
)
clock = RosClock()


@pytest.fixture
def robot(monkeypatch: pytest.MonkeyPatch) -> Robot:
    return Robot(monkeypatch)


@pytest.fixture
def ros2(robot: Robot) -> Iterator[Ros2]:
    named = Ros2Config(domain=robot.domain, odometry="/odometry", odometry_is_enu=True)
    with closing(Ros2(named, clock, clock.unix_ns)) as ours:
        ours.datum = DATUM
        assert list(ours.odometry()) == []
        yield ours


def decoded(messages: list[Any], kind: str) -> Any:
    (message,) = messages
    return STORE.deserialize_cdr(message.serialize(), kind.replace("/", "/msg/"))


def test_each_message_has_the_fields_of_ros_2() -> None:
    from rosbags.interfaces import Nodetype

    def spelled(what: Any) -> str:
        kind, value = what
        if kind in (Nodetype.BASE, Nodetype.NAME):
            return str((value[0] if kind == Nodetype.BASE else value).replace("/msg/", "/"))
        return f"{spelled(value[0])}[{value[1] if kind == Nodetype.ARRAY else ''}]"

    for name, fields in DEFINITIONS.items():
        theirs = STORE.fielddefs[name.replace("/", "/msg/")][1]
        assert fields == ", ".join(f"{spelled(kind).replace('octet', 'byte')} {field}" for field, kind in theirs), name


def test_a_position_is_heard_with_its_own_time_place_and_covariance(ros2: Ros2, robot: Robot) -> None:
    kinds = {"lookback/pose": "geometry_msgs/PoseWithCovarianceStamped", "lookback/fix": "sensor_msgs/NavSatFix"}
    for name, kind in kinds.items():
        robot.listen(name, kind)
    ros2.publish_position(FIX)
    pose, fix = (decoded(robot.heard(name), kind) for name, kind in kinds.items())
    for header, frame in ((pose.header, "map"), (fix.header, "base_link")):
        assert header.stamp.sec * 10**9 + header.stamp.nanosec == clock.unix_ns() - 400_000_000
        assert header.frame_id == frame
    assert FIX.lat_deg is not None and FIX.lon_deg is not None
    at = pose.pose.pose.position
    assert (at.x, at.y) == east_north_of(FIX.lat_deg, FIX.lon_deg, DATUM)
    assert (fix.latitude, fix.longitude) == (FIX.lat_deg, FIX.lon_deg) and math.isnan(fix.altitude)
    turn = pose.pose.pose.orientation
    assert 2 * math.atan2(turn.z, turn.w) == pytest.approx(math.radians(30)), "60 degrees from north"
    ground = np.array(pose.pose.covariance).reshape(6, 6)[:2, :2]
    assert ground == pytest.approx(np.array(fix.position_covariance).reshape(3, 3)[:2, :2])
    along = np.array([math.sin(math.radians(60)), math.cos(math.radians(60))])  # east, north
    assert along @ ground @ along == pytest.approx(16.0)
    assert np.linalg.eigvalsh(ground) == pytest.approx([4.0, 16.0])
    assert (fix.position_covariance_type, fix.status.status) == (3, 0)


def test_without_a_heading_the_larger_deviation_holds_all_around(ros2: Ros2, robot: Robot) -> None:
    robot.listen("lookback/place", "geometry_msgs/PoseWithCovarianceStamped")
    ros2.publish_place(replace(FIX, heading_deg=None))
    ros2.publish_place(replace(FIX, lat_deg=None, lon_deg=None))
    (heard,) = robot.heard("lookback/place")
    covariance = heard.pose.covariance
    assert (covariance[0], covariance[1], covariance[7]) == (16.0, 0.0, 16.0)
    assert covariance[35] >= 1e6, "the yaw is not known"


def test_the_state_is_a_diagnostic_once_a_second(ros2: Ros2, robot: Robot) -> None:
    robot.listen("diagnostics", "diagnostic_msgs/DiagnosticArray")
    asked: list[LinkStatus] = []

    def link() -> LinkStatus:
        asked.append(LinkStatus("up", "udp:x", "report"))
        return asked[-1]

    for _ in range(3):
        ros2.publish_state("off the map", "not recognized for 20 m", link)
    assert len(asked) == 1
    (status,) = decoded(robot.heard("diagnostics"), "diagnostic_msgs/DiagnosticArray").status
    assert (status.level, status.message) == (1, "off the map: not recognized for 20 m")
    assert {("state", "up"), ("gps", "unknown")} <= {(one.key, one.value) for one in status.values}


def test_odometry_is_heard_with_its_own_time_and_ignored_where_it_is_damaged(ros2: Ros2, robot: Robot) -> None:
    now_ns = clock.unix_ns()
    robot.send_odometry(now_ns - 50_000_000, 5.0, 0.3, yaw_rad=0.5)
    (heard,) = ros2.odometry()
    assert heard.stamp_ns == clock() - 50_000_000
    assert heard[1:] == pytest.approx((5.0, 0.3, 0.5))
    robot.send_odometry(now_ns, math.nan)
    robot.send_odometry(now_ns, 5.0, variance=9.0)
    for off_s in (-5, 5):
        robot.send_odometry(now_ns + off_s * 10**9, 5.0)
    assert list(ros2.odometry()) == []


def test_a_publisher_of_odometry_that_leaves_is_no_odometry(ros2: Ros2, robot: Robot) -> None:
    robot.send_odometry(clock.unix_ns(), 5.0)
    assert len(list(ros2.odometry())) == 1
    robot.leave()
    assert list(ros2.odometry()) == []
