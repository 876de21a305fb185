"""Positions by the pose of one picture, where the truth is known."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Literal

import numpy as np
import pytest
from msgspec import UNSET

from edge.config import CameraConfig, Config, DescriptorConfig, GatesConfig, RigConfig, SamplingConfig
from edge.geodesy import east_north_of
from edge.keypoints.drive_points import points_of_drive
from edge.keypoints.network import KeypointNetwork
from edge.keypoints.pose import pose_to_keyframe
from edge.keypoints.view_geometry import CameraModel
from edge.localization import HOLE_S, Fix, NoFix, PlaceFix
from edge.localization.drive_file import PlaceTable
from edge.localization.sequence_match import Georeferencer
from edge.reference_map import Route
from edge.reference_map.place_records import PLACE
from edge.reference_map.store import MapHeader, ModelKey, RegionsKey
from edge.sequence import KeyframeMatch, PlaceMatch
from sim import ORIGIN_LAT_DEG, ORIGIN_LON_DEG, Pose
from sim.research.trial.course_map import place_at
from sim.world.camera import open_renderer
from sim.world.scenario import Scenario, View
from tests.common import S
from tests.localization.events_of import (
    LINE_M,
    SPEED_MPS,
    Direction,
    Road,
    Sees,
    Vehicle,
    left_m,
    match,
    north_m,
    nothing,
    settings,
    warm,
)
from tests.localization.route_course import SPACING_M, Stretch

MEASURED = settings(RigConfig(look_sigma_m=0.01))
BELIEVED = settings(RigConfig(look_sigma_m=0.01), GatesConfig(risk=1.0))
SIGMAS = 0.2, 0.2, math.radians(0.5)
ROAD = Scenario(seed=9801, length_m=200.0)
CAMERA = CameraModel(ROAD.width, ROAD.height, ROAD.fov_deg)
ROWS_M = np.arange(90.0, 111.0, 2.0)
ROW = 5


def seen(place: int, west_m: float = 0.0, ahead_m: float = 0.0, turn_deg: float = 0.0, **changes: Any) -> KeyframeMatch:
    """A camera that looks south as the row's did, so far to its right, which is west, and ahead of it."""
    fields = {"points": 40, "confidence": 0.9, "covariance": np.diag(np.square(SIGMAS))}
    return KeyframeMatch(
        place, right_m=west_m, ahead_m=ahead_m, turn_rad=math.radians(turn_deg), **{**fields, **changes}
    )


def poses(road: Road, west_m: float = 0.0, direction: Direction = "reverse", **changes: Any) -> Sees:
    """Frames that show a vehicle so far beside the drive of the map's rear camera, and a line that ends 4 m off."""

    def sees(at_m: float) -> PlaceMatch | None:
        place = round(at_m / SPACING_M)
        return match(place + 2, direction, order="same", seen=seen(place, west_m, **changes))

    return sees


def homeward(road: Road, config: Config = MEASURED, sees: Sees | None = None, meters: float = 40.0) -> Vehicle:
    """A vehicle that goes home, to the south."""
    return warm(road, config, 300.0, "reverse", sees or poses(road, 1.5), meters)


@pytest.mark.parametrize(
    ("mapped", "camera", "reverse", "left_m"),
    [("front", "front", False, -0.5), ("rear", "front", True, 0.0), ("front", "rear", True, 0.0)],
)
def test_a_pose_of_rendered_pictures_puts_a_vehicle_where_it_is(
    mapped: View, camera: View, reverse: bool, left_m: float
) -> None:
    """The same way and home, in the other lane; turned by 3 degrees."""
    rows = _Rendered(mapped, "day", ROWS_M)
    places = np.array([place.record() for place in rows.places()], PLACE)
    header = MapHeader.begun(ModelKey("none", "0", "tap", 1), RegionsKey.of(DescriptorConfig()), SamplingConfig())
    header = header.with_segment("drive", mapped, whole_sigma_m=0.0).with_places(len(places))
    direction: Direction = "reverse" if reverse else "forward"
    config = Config(camera=CameraConfig(view=camera), rig=RigConfig(look_sigma_m=0.01))
    georeferencer = Georeferencer(Route(PlaceTable(places, (header,))), config)

    vehicle = _Rendered(camera, "dusk", np.array([101.3]), reverse=reverse, left_m=left_m, turned_deg=3.0)
    truth = vehicle.poses[0]
    heading = np.radians([pose.heading_deg for pose in rows.poses])
    faces_back = mapped == "rear"
    ((points, _),) = points_of_drive(rows.keypoints.__getitem__, ROWS_M, heading, CAMERA, [ROW], faces_back=faces_back)
    pose = pose_to_keyframe(vehicle.keypoints[0], rows.keypoints[ROW], points, CAMERA)
    assert pose is not None
    found = KeyframeMatch(ROW, pose.right_m, pose.ahead_m, pose.turn_rad, pose.covariance, pose.inliers, 0.9)
    measured = georeferencer.pose_measurement(match(ROW, direction, order="same", seen=found))

    assert measured is not None and measured.pose is not None and georeferencer.origin is not None
    origin_m = east_north_of(*georeferencer.origin, (ORIGIN_LAT_DEG, ORIGIN_LON_DEG))
    off_m = measured.pose.position_m + origin_m - [truth.east_m, truth.north_m]
    assert np.hypot(*off_m) < 0.5
    heading_deg = math.degrees(measured.pose.heading_rad)
    assert math.remainder(heading_deg - truth.heading_deg, 360.0) == pytest.approx(0.0, abs=1.5)


class _Rendered:
    """Pictures of a road from some arc lengths, and where the vehicle is at each."""

    def __init__(
        self,
        view: View,
        light: Any,
        route_m: np.ndarray[Any, np.dtype[np.float64]],
        *,
        reverse: bool = False,
        left_m: float = 0.0,
        turned_deg: float = 0.0,
    ) -> None:
        way: Literal["reverse", "forward"] = "reverse" if reverse else "forward"
        one = Scenario(ROAD.seed, ROAD.length_m, direction=way, light=light, view=view)
        drive, sign = one.drive(), -1.0 if reverse else 1.0
        renderer, network = open_renderer(one, drive), KeypointNetwork()
        at = [drive.route.at(meters, sign * (one.lane_m + left_m)) for meters in route_m.tolist()]
        turned_deg += 180.0 * reverse
        self.route_m = route_m
        self.poses = [Pose(east, north, (math.degrees(rad) + turned_deg) % 360, 0.0, 100.0) for east, north, rad in at]
        self.keypoints = [network.extract(renderer.render(pose, 1.0)) for pose in self.poses]
        renderer.close()

    def places(self) -> list[Any]:
        """Of a map, whose positions are right."""
        found = []
        for row, (meters, pose) in enumerate(zip(self.route_m.tolist(), self.poses, strict=True)):
            at = pose.east_m, pose.north_m, math.radians(pose.heading_deg)
            found.append(place_at(row, meters, at, np.zeros(2)))
        return found


@pytest.mark.parametrize("direction", ["forward", "reverse"])
def test_poses_say_where_a_vehicle_is_along_and_across_whatever_its_line_says(road: Road, direction: Direction) -> None:
    """Home, and backwards on the way home: the camera looks south either way."""
    one = Vehicle(road, MEASURED, 200.0, direction)
    one.nose_deg = 180.0 * (direction == "forward")
    one.go(LINE_M, nothing)
    one.go(40, poses(road, 1.5, direction))
    assert one.place is not None
    assert (north_m(one.place), left_m(one.place)) == pytest.approx((one.north_m, 1.5), abs=0.05)
    assert (one.place.points, one.place.by_lane) == (40, False)
    assert one.place.heading_deg == pytest.approx(180.0, abs=0.01)
    assert 0.8 <= one.place.sigma_cross_track_m < 1.1, "the map's own error, and little besides"


def test_what_the_camera_is_turned_by_is_the_vehicles_heading(road: Road) -> None:
    """It is followed where the vehicle turns between two poses."""
    one = homeward(road, sees=poses(road, turn_deg=4.0))
    assert one.place is not None and one.place.heading_deg == pytest.approx(184.0, abs=0.2)
    one.sideways_m = -SPACING_M * math.tan(math.radians(5.0))
    one.go(6, lambda at_m: road.match(at_m, "reverse"))
    assert one.place is not None and one.place.heading_deg == pytest.approx(189.0, abs=0.2)
    one.sideways_m = 0.0
    one.go(80, lambda at_m: road.match(at_m, "reverse"))
    assert one.place is not None and (one.place.heading_deg, one.place.points) == (180.0, UNSET), "then of the road"


def test_a_pose_that_takes_a_turn_for_a_shift_moves_no_vehicle(road: Road) -> None:
    """Of far points both look alike: 5 m to the side and 5 degrees turned, where the heading is known to a degree."""
    one = homeward(road)
    sigmas = np.array([1.2, 0.4, math.radians(1.2)])
    alike = np.array([[1.0, 0.0, 0.95], [0.0, 1.0, 0.0], [0.95, 0.0, 1.0]])
    one.go(10.0, poses(road, 1.5 + 5.0, turn_deg=5.0, covariance=alike * np.outer(sigmas, sigmas)))
    assert left_m(one.place) == pytest.approx(1.5, abs=0.5)


def test_how_far_cameras_are_ahead_of_their_antennas_is_taken_off_or_is_not_known(road: Road) -> None:
    measured = homeward(road, settings(RigConfig(look_ahead_reverse_m=1.2, look_sigma_m=0.1)))
    assert north_m(measured.place) == pytest.approx(measured.north_m + 1.2, abs=0.05)
    unknown = homeward(road, settings()).place
    assert unknown is not None and unknown.sigma_along_m >= 3.0 and unknown.sigma_cross_track_m < 1.1


def test_poses_alone_are_enough_where_no_line_is_known(road: Road) -> None:
    one = Vehicle(road, MEASURED, 100.0, "reverse")
    one.go(4, lambda at_m: match(round(at_m / 2), "reverse", order="same", has_line=False, seen=seen(round(at_m / 2))))
    assert north_m(one.place) == pytest.approx(one.north_m, abs=0.05)


def test_poses_close_together_share_what_they_say(road: Road) -> None:
    """Ten of them 2 m apart count as about three, and any number of a vehicle that stands as about one."""
    loose = settings(RigConfig(look_sigma_m=0.01), scale_error_percent=0.01, heading_error_deg=0.01)
    sigmas, wide = [], poses(road, covariance=np.diag([4.0, 4.0, 1e-4]))

    def sees(at_m: float) -> PlaceMatch | None:
        found = wide(at_m)
        return found and replace(found, has_line=False)

    for meters, times in ((4, 0), (22, 0), (4, 50)):
        one = homeward(road, loose, sees, meters)
        for _ in range(times):
            one.t_ns += 200_000_000
            one.show(sees(one.north_m))
        assert one.place is not None
        sigmas.append(math.sqrt(one.place.sigma_cross_track_m**2 - 1.0))
    first, ten, standing = sigmas
    assert first == pytest.approx(math.sqrt(4 * 12 / (4 + 12)), abs=0.1), "two, of which one counts a third"
    assert 0.4 * first < ten < 0.8 * first
    assert standing > 0.85 * first


def test_a_single_pose_waits_for_one_that_agrees(road: Road) -> None:
    one = homeward(road, sees=poses(road, -1.0), meters=2.0)
    assert one.place is None or one.place.points is UNSET
    one.go(4, poses(road, 1.5))
    assert left_m(one.place) == pytest.approx(1.5, abs=0.05)


def test_a_second_solution_now_and_then_moves_nothing(road: Road) -> None:
    one = homeward(road)
    for _ in range(5):
        one.go(2, poses(road, -1.0))
        assert left_m(one.place) == pytest.approx(1.5, abs=0.05)
        one.go(4, poses(road, 1.5))
    assert one.place is not None and not one.place.disputed


def test_an_estimate_that_began_with_a_second_solution_is_outvoted(road: Road) -> None:
    one = homeward(road, sees=poses(road, -1.0), meters=4.0)
    assert left_m(one.place) == pytest.approx(-1.0, abs=0.1)
    one.go(6, poses(road, 1.5))
    assert left_m(one.place) == pytest.approx(1.5, abs=0.1)
    assert one.place is not None and one.place.disputed, "those that outvote may be outvoted again"
    one.go(SPEED_MPS * HOLE_S, poses(road, 1.5))
    assert one.place is not None and not one.place.disputed


def test_no_number_of_poses_moves_an_estimate_to_another_place(road: Road) -> None:
    """What follows is disputed, and what was known before is back with the first poses that agree with it."""
    one = homeward(road, meters=80.0)
    for _ in range(10):
        one.go(2, poses(road, 1.5, ahead_m=30.0))
        assert one.place is not None
        assert one.place.disputed or abs(north_m(one.place) - one.north_m) < 6.0
    one.go(8, poses(road, 1.5))
    assert one.place is not None and not one.place.disputed
    assert north_m(one.place_at()) == pytest.approx(one.north_m, abs=0.1)


@pytest.mark.parametrize(("whole_sigma_m", "is_followed"), [(0.0, False), (None, True)])
def test_a_drive_that_nobody_aligned_may_be_off_as_a_whole(
    mapped: Callable[..., Road], whole_sigma_m: float | None, is_followed: bool
) -> None:
    """Poses have a vehicle 15 m from where GPS has had it; where the whole drive may be, it stays there."""
    one = Vehicle(mapped(Stretch(0, 400, sigma_m=1.0, whole_sigma_m=whole_sigma_m)), MEASURED, 300.0, "reverse")
    one.go(LINE_M, nothing, gps=True)
    one.go(
        8,
        lambda at_m: match(
            round(at_m / 2), "reverse", order="same", has_line=False, seen=seen(round(at_m / 2), ahead_m=15.0)
        ),
    )
    assert one.place is not None
    assert north_m(one.place) == pytest.approx(one.north_m - (0.0 if is_followed else 15.0), abs=3.0)
    assert one.place.disputed != is_followed


def pose_now(one: Vehicle) -> PlaceFix | None:
    """What may be sent as a measurement now, whether or not the rules for it hold."""
    answer = one.ask(at="pose")
    assert isinstance(answer, NoFix) or answer.pose_sigma_m is not None
    return answer.place if isinstance(answer, Fix) else answer.fix


def test_a_pose_is_handed_on_as_it_was_measured(road: Road) -> None:
    """The filter weighs what was before; nothing of that is in a pose, nor is the error of the map in its own sigma."""
    one = homeward(road, BELIEVED)
    one.go(2, poses(road, 2.0, ahead_m=0.5, turn_deg=1.0, covariance=np.diag([0.04, 0.04, 1e-4])))
    pose, answer = pose_now(one), one.ask(at="pose")
    assert (north_m(pose), left_m(pose)) == pytest.approx((one.north_m - 0.5, 2.0), abs=0.02)
    assert 1.5 < left_m(one.place) < 1.9
    assert isinstance(answer, Fix) and answer.pose_sigma_m == pytest.approx(0.2, abs=0.02)
    assert answer.place.sigma_along_m > 0.9 and answer.place.heading_deg == pytest.approx(181.0, abs=0.05)
    assert answer.motion == one.motion and answer.place.stamp_ns == one.t_ns


def test_the_newest_pose_is_handed_on_and_no_prediction_or_sequence_match(road: Road) -> None:
    """Nor by a message that carries where the vehicle is now."""
    one = homeward(road, BELIEVED)
    posed_ns, at_m = one.t_ns, one.north_m
    one.go(20, lambda at_m: road.match(at_m, "reverse"))
    assert one.place is not None and one.place.stamp_ns > posed_ns
    for at in ("pose", "now"):
        answer = one.ask(at=at)
        assert isinstance(answer, Fix) and answer.place.stamp_ns == posed_ns == one.drive.pose_ns
        assert north_m(answer.place) == pytest.approx(at_m, abs=0.05)
    alone = warm(road, MEASURED, 300.0, "reverse")
    assert alone.place is not None and pose_now(alone) is None and alone.drive.pose_ns is None


@pytest.mark.parametrize("blind_s", [HOLE_S - 0.5, HOLE_S + 0.5])
def test_after_a_hole_two_poses_must_agree(road: Road, blind_s: float) -> None:
    """An autopilot without a pose for 10 s takes the next one for its position."""
    one = homeward(road)
    one.go(SPEED_MPS * blind_s - SPACING_M, lambda at_m: road.match(at_m, "reverse"))
    one.go(SPACING_M, poses(road, 1.5))
    assert (pose_now(one) is not None) is (blind_s < HOLE_S)
    one.go(SPACING_M, poses(road, 1.5))
    assert left_m(pose_now(one)) == pytest.approx(1.5, abs=0.05)
    assert one.drive.pose_ns == one.t_ns


@pytest.mark.parametrize("confidence", [0.49, 0.51])
def test_faint_poses_that_agree_are_no_evidence_of_another_place(road: Road, confidence: float) -> None:
    """Four in a row of a bend were 6 to 8 m behind."""
    one = homeward(road)
    one.go(8, poses(road, 1.5, ahead_m=-7.0, confidence=confidence))
    assert north_m(one.place_at()) - one.north_m == pytest.approx(7.0 if confidence > 0.5 else 0.0, abs=1.0)
    one.go(SPACING_M, poses(road, 1.5))
    assert (one.drive.pose_ns == one.t_ns) is (confidence < 0.5)


def test_poses_that_outvote_where_the_vehicle_was_are_not_handed_on_for_a_while(road: Road) -> None:
    """Five in a bend agreed 7 to 8 m behind it: an autopilot without a pose for 10 s would have gone there."""
    one = homeward(road)
    posed_ns = one.t_ns
    for _ in range(8):
        one.go(SPACING_M, poses(road, 1.5, ahead_m=-7.0))
        handed = pose_now(one)
        assert handed is None or handed.stamp_ns == posed_ns
    assert north_m(one.place_at()) - one.north_m == pytest.approx(7.0, abs=1.0), "they have outvoted it"
    one.go(SPEED_MPS * HOLE_S, poses(road, 1.5, ahead_m=-7.0))
    assert one.drive.pose_ns == one.t_ns


def test_poses_that_were_outvoted_again_speak_against_no_later_ones(road: Road) -> None:
    """A few were 7 m off in a bend: 40 m later they took the right ones for theirs, and no pose was sent for 130 m."""
    one = Vehicle(road, MEASURED, 440.0, "reverse")
    one.go(60, poses(road, 1.5), gps=True)
    one.go(20, poses(road, 1.5))
    fused = one.ask(at="pose")
    assert isinstance(fused, Fix)
    one.use(fused)
    one.go(8, poses(road, 1.5, ahead_m=-7.0))
    assert north_m(one.place_at()) - one.north_m == pytest.approx(7.0, abs=1.0), "they have outvoted it"
    one.go(SPEED_MPS * (HOLE_S + 1.0), poses(road, 1.5))
    for _ in range(60):
        one.go(SPACING_M, poses(road, 1.5))
        assert isinstance(one.ask(at="pose"), Fix)


@pytest.mark.parametrize(("shift_m", "turn_deg"), [(-1.0, 0.0), (6.5, 5.0)])
def test_a_pose_that_fails_the_innovation_test_is_not_handed_on(road: Road, shift_m: float, turn_deg: float) -> None:
    one = homeward(road)
    before = pose_now(one)
    one.go(SPACING_M, poses(road, shift_m, turn_deg=turn_deg))
    assert before is not None and pose_now(one) == before
    one.go(SPACING_M, poses(road, 1.5))
    assert one.drive.pose_ns == one.t_ns and left_m(pose_now(one)) == pytest.approx(1.5, abs=0.05)


def test_where_a_speed_was_bridged_the_position_along_the_road_is_as_uncertain_as_that(road: Road) -> None:
    """It is off in one way from the first meter to the last, however many frames lie between; a pose ends that."""
    one = homeward(road)
    before = one.place_at()
    assert before is not None
    for frame in range(1, 8):
        one.motion = one.moved(unknown_m=one.motion.unknown_m + 0.6)
        one.go(SPACING_M, nothing)
        place = one.place_at()
        assert place is not None
        expected_m = math.hypot(before.sigma_along_m, 0.6 * frame / math.sqrt(3))
        assert place.sigma_along_m == pytest.approx(expected_m, rel=0.1)
        assert place.sigma_cross_track_m < before.sigma_cross_track_m + 0.3
    ahead = one.place_at(S // 2, 4.0, unknown_m=one.motion.unknown_m + 3.0)
    one.go(SPACING_M, poses(road, 1.5))
    after = one.place_at()
    assert ahead is not None and after is not None
    assert ahead.sigma_along_m == pytest.approx(math.hypot(before.sigma_along_m, 7.2 / math.sqrt(3)), rel=0.1)
    assert after.sigma_along_m < before.sigma_along_m + 0.1


def test_a_line_moves_nothing_that_poses_have_measured(road: Road) -> None:
    one = homeward(road)
    soon, later = one.place_at(S // 2, 4.0), one.place_at(2 * S, 16.0)
    assert soon is not None and later is not None and (soon.points, later.points) == (40, UNSET)
    one.go(30, lambda at_m: road.match(at_m + 4.0, "reverse"))
    assert one.place is not None and one.place.points is UNSET, "the newest frame had no pose"
    assert (north_m(one.place), left_m(one.place)) == pytest.approx((one.north_m, 1.5), abs=0.1)


def _heading_error(one: Vehicle) -> tuple[float, float]:
    found = one.drive.state.heading_error
    assert found is not None
    return math.degrees(found[0]), math.degrees(found[1])


@pytest.mark.parametrize("askew_deg", [0.0, 3.0])
def test_poses_find_the_heading_error_of_the_velocity_and_not_that_of_the_camera(road: Road, askew_deg: float) -> None:
    """A camera that is mounted askew is so with GPS already; after it, the autopilot's heading goes wrong."""
    one, sees = Vehicle(road, MEASURED, 390.0, "reverse"), poses(road, turn_deg=askew_deg)
    one.go(LINE_M, nothing, gps=True)
    one.go(100.0, sees, gps=True)
    assert _heading_error(one)[0] == pytest.approx(0.0, abs=0.3)
    one.compass_rad, one.sideways_m = math.radians(3.0), -SPACING_M * math.tan(math.radians(3.0))  # right of the south
    one.go(60.0, sees)
    found_deg, sigma_deg = _heading_error(one)
    assert found_deg == pytest.approx(-3.0, abs=0.8) and sigma_deg < 1.0
    one.go(80.0, lambda at_m: road.match(at_m, "reverse"))
    assert one.drive.state.heading_error is None, "poses are far behind"


@pytest.mark.parametrize(("askew_deg", "points"), [(12.0, 40), (16.0, None)])
def test_poses_of_a_camera_that_is_mounted_far_askew_do_not_count(
    road: Road, askew_deg: float, points: int | None
) -> None:
    place = homeward(road, sees=poses(road, turn_deg=askew_deg)).place
    assert (place.points if place else None) == points


def test_a_vehicle_that_flies_to_the_side_has_no_heading_error_by_that(road: Road) -> None:
    one = Vehicle(road, MEASURED, 390.0, "reverse")
    one.nose_deg = 40.0
    one.go(LINE_M, nothing, gps=True)
    one.go(60.0, poses(road, turn_deg=40.0), gps=True)
    assert _heading_error(one)[0] == pytest.approx(0.0, abs=0.1)
    assert one.place is not None and one.place.points == 40
