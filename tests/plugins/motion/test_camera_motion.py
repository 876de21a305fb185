"""The vehicle's speed from its pictures: its scale is learned from GPS, kept, and silent where nothing is seen."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from edge.config import CameraConfig, Config, TelemetryConfig
from edge.journal.records import Record
from edge_plugins.motion import MotionConfig
from edge_plugins.motion.camera_motion import CameraMotion, CameraSpeed, MotionMeasured
from edge_plugins.motion.height import WINDOW_M, WINDOWS, CameraHeight, HeightRecord
from edge_plugins.motion.velocity_sender import MOST_SCALE
from tests.files_written import wait_for_files
from tests.plugins.motion.road import FOV_DEG, HEIGHT, WIDTH, picture

STEP_NS, STEP_M, MPS = 100_000_000, 0.7, 7.0
REAR = np.kron(np.random.default_rng(8).integers(0, 2, (24, 20)), np.ones((10, 10))).astype(np.uint8) * 220 + 20


def config(folder: Path | None = None, view: str = "front") -> Config:
    journal = str(folder / "events.jsonl") if folder else ""
    camera = msgspec.convert({"view": view, "fov_deg": FOV_DEG}, CameraConfig)
    return Config(
        camera=camera, telemetry=TelemetryConfig(journal=journal), plugins={"motion": MotionConfig(use="report")}
    )


def known(motion: CameraMotion) -> CameraMotion:
    """With a height that GPS has shown on this drive."""
    motion.height = CameraHeight(HeightRecord("", 0.0), 40)
    for _ in range(5):
        motion.height.compare(WINDOW_M, WINDOW_M / 1.4, (0.0, 0.0), 0)
    return motion


def drive(
    motion: CameraMotion, steps: int, *, first_ns: int = STEP_NS, gps_mps: float | None = None, step_m: float = STEP_M
) -> list[CameraSpeed | None]:
    """One speed for each picture of a drive at MPS."""
    return [motion.follow(picture(20.0 + step_m * step), first_ns + step * STEP_NS, gps_mps) for step in range(steps)]


def slipping(motion: CameraMotion, steps: int, yaw_deg: float, gps: tuple[float | None, float]) -> CameraSpeed:
    """A camera that is turned to the right, of a vehicle that slips to the left by 3 degrees."""
    for step in range(steps):
        at_m, slip_m = 20.0 + STEP_M * (step % 10), -math.tan(math.radians(3.0)) * STEP_M * (step % 10)
        image = picture(at_m, east_m=slip_m, heading_rad=math.radians(yaw_deg))
        motion.follow(image, (step + 1 + 1000 * (step // 10)) * STEP_NS, *gps)
    assert motion.speed is not None
    return motion.speed


@pytest.mark.parametrize("yaw_deg", [0.0, 1.5])
def test_a_vehicle_that_slips_is_measured_once_gps_has_shown_the_cameras_yaw(yaw_deg: float) -> None:
    motion = CameraMotion(config())
    first = slipping(motion, 90, yaw_deg, (MPS, -math.tan(math.radians(3.0))))
    assert motion.height.yaw_rad == pytest.approx(math.radians(yaw_deg), abs=math.radians(0.4))
    later = slipping(motion, 10, yaw_deg, (None, 0.0))
    for one in (first, later):
        assert one.right_mps == pytest.approx(-0.37, abs=0.1)
        assert 0.05 < one.right_sigma_mps < 0.2


def test_until_then_a_slip_is_not_known() -> None:
    motion = CameraMotion(config())
    motion.height = CameraHeight(HeightRecord("", 0.0, (1.4,) * 5), 40)
    one = slipping(motion, 10, 0.0, (None, 0.0))
    assert one.right_mps == 0.0 and one.right_sigma_mps == pytest.approx(0.21, abs=0.02)


def test_without_a_height_nothing_is_measured_and_the_reason_is_said() -> None:
    motion = CameraMotion(config())
    assert drive(motion, 3) == [None, None, None]
    assert motion.why == "the height of the camera is not learned yet"


def test_the_height_is_learned_from_gps_and_kept(tmp_path: Path) -> None:
    records: list[Record] = []
    motion = CameraMotion(config(tmp_path), records.append)
    for lap in range(round((WINDOWS + 3) * WINDOW_M / STEP_M / 8) + 2):
        drive(motion, 10, first_ns=(1 + 1000 * lap) * STEP_NS, gps_mps=MPS)
    assert motion.height.height_m == pytest.approx(1.4, rel=0.02)
    drive(motion, 12, first_ns=10**6 * STEP_NS)
    speed = motion.speed
    assert speed is not None and speed.speed_mps == pytest.approx(MPS, abs=3 * speed.sigma_mps)
    wait_for_files()
    again = CameraMotion(config(tmp_path))
    assert again.height.kept == motion.height.kept
    assert again.height.share > 0.1 > motion.height.share, "it may have been mounted anew"
    assert CameraMotion(config(tmp_path, "rear")).height.height_m is None, "another camera has another height"
    seen = [one for one in records if isinstance(one, MotionMeasured)]
    assert seen[-1].speed_mps == pytest.approx(MPS, rel=0.05) and seen[0].why


def test_the_stamp_is_the_middle_between_two_exposures_and_the_speed_honest() -> None:
    motion = known(CameraMotion(config()))
    speeds = drive(motion, 12)
    assert speeds[:2] == [None, None], "the first motion that is found may be that of something else"
    for step, speed in enumerate(speeds[2:], start=2):
        assert speed is not None
        assert speed.stamp_ns == (step + 0.5) * STEP_NS
        assert abs(speed.speed_mps - MPS) < 3 * speed.sigma_mps
        assert speed.sigma_mps < 0.06 * MPS


def test_the_same_pictures_give_the_same_speeds_to_the_last_bit() -> None:
    assert drive(known(CameraMotion(config())), 8) == drive(known(CameraMotion(config())), 8)


def test_a_rear_camera_drives_ahead_where_the_road_goes_away() -> None:
    speeds = drive(known(CameraMotion(config(view="rear"))), 4, step_m=-STEP_M)
    assert speeds[3] is not None and speeds[3].speed_mps == pytest.approx(MPS, rel=0.03)


@pytest.mark.parametrize(("view", "sign"), [("front", 1.0), ("rear", -1.0)])
def test_what_lifts_the_nose_lowers_the_view_of_a_rear_camera(view: str, sign: float) -> None:
    dive_rad, asked = math.radians(1.0), []

    def turned_rad(since_ns: int, until_ns: int) -> tuple[float, float]:
        asked.append((since_ns, until_ns))
        return (-sign * dive_rad if len(asked) == 3 else 0.0), 0.0

    motion = known(CameraMotion(config(view=view), turned_rad=turned_rad))
    for step in range(4):
        pitch_rad = dive_rad if step == 3 else 0.0
        speed = motion.follow(picture(20.0 + sign * STEP_M * step, pitch_rad=pitch_rad), (1 + step) * STEP_NS, None)
    assert asked[2] == (3 * STEP_NS, 4 * STEP_NS)
    assert speed is not None and speed.speed_mps == pytest.approx(MPS, rel=0.02)


def test_it_is_silent_at_the_first_picture_without_light_and_measures_again_with_the_second_that_has_it() -> None:
    motion = known(CameraMotion(config()))
    assert drive(motion, 4)[-1] is not None
    assert motion.follow(picture(25.0, light=0.0), 5 * STEP_NS, None) is None
    assert motion.why == "too few corners of the ground to be tracked"
    assert motion.follow(picture(20.0), 6 * STEP_NS, None) is None
    assert motion.follow(picture(20.7), 7 * STEP_NS, None) is not None


def test_after_half_a_second_of_darkness_a_motion_must_be_found_twice() -> None:
    motion = known(CameraMotion(config()))
    drive(motion, 4)
    for dark in range(6):
        motion.follow(picture(25.0, light=0.0, seed=dark), (5 + dark) * STEP_NS, None)
    lit = [motion.follow(picture(20.0 + STEP_M * step), (11 + step) * STEP_NS, None) for step in range(3)]
    assert lit[:2] == [None, None] and lit[2] is not None


def test_a_picture_that_comes_soon_is_passed_over_and_a_late_one_begins_anew() -> None:
    motion = known(CameraMotion(config()))
    first = drive(motion, 3)[-1]
    assert motion.follow(picture(21.7), 3 * STEP_NS + 30_000_000, None) is None
    assert motion.speed == first and first is not None
    assert motion.follow(picture(21.4), 20 * STEP_NS, None) is None
    assert motion.why == "no picture shortly before"


def test_a_speed_that_no_vehicle_reaches_so_soon_is_not_published() -> None:
    motion = known(CameraMotion(config()))
    assert drive(motion, 4)[-1] is not None
    assert motion.follow(picture(22.35, seed=7), 5 * STEP_NS, None) is None, "2.5 after 7 m/s"
    assert motion.why == "the ground has not moved alike twice in a row"


def behind_a_truck(north_m: float, away_m: float, seed: int) -> NDArray[np.uint8]:
    """The road with the rear of a truck, 2.5 m wide."""
    focal_px = WIDTH / 2 / math.tan(math.radians(FOV_DEG) / 2)
    left, right = (round(WIDTH / 2 + focal_px * side_m / away_m) for side_m in (-1.25, 1.25))
    top, bottom = (round(HEIGHT / 2 + focal_px * (1.4 - high_m) / away_m) for high_m in (3.5, 0.4))
    rear = cv2.resize(REAR, (right - left, bottom - top), interpolation=cv2.INTER_AREA)
    image = picture(north_m, seed=seed, light=0.3, noise=4.0).copy()
    image[max(top, 0) : bottom, max(left, 0) : right] = rear[max(-top, 0) : HEIGHT - top, max(-left, 0) :, None][
        :, : WIDTH - max(left, 0)
    ]
    return image


def beside_water(flown_m: float, from_px: int, seed: int) -> NDArray[np.uint8]:
    """The ground where the vehicle stands, and to the right of from_px water that flows towards it."""
    image = picture(8.0, seed=seed).copy()
    image[:, from_px:] = picture(8.0 + flown_m, seed=seed + 500)[:, from_px:]
    return image


@pytest.mark.parametrize(("mps", "away_m", "closes_mps"), [(3.0, 3.0, 0.3), (2.0, 3.0, 0.3), (2.0, 4.0, 0.5)])
def test_a_truck_that_fills_most_of_the_picture_is_not_what_is_measured(
    mps: float, away_m: float, closes_mps: float
) -> None:
    """In up to 22 of 40 pictures it said 0.3 to 0.6 m/s, up to 48 standard deviations off."""
    motion, far = known(CameraMotion(config())), 0
    for step in range(41):
        now_m = away_m - closes_mps * step / 10
        speed = motion.follow(behind_a_truck(5.0 + mps * step / 10, now_m, step), (1 + step) * STEP_NS, None)
        assert speed is None or abs(speed.speed_mps - mps) < 4 * speed.sigma_mps
        far += speed is not None and now_m > 3.2
    assert far >= (5 if away_m > 3.2 else 0), "where the road is most of the picture, it is measured"


@pytest.mark.parametrize("from_px", [WIDTH // 7, WIDTH // 4])
def test_it_is_silent_where_it_stands_beside_water_that_flows(from_px: int) -> None:
    """It said 0.99 m/s, 18 standard deviations off."""
    motion = known(CameraMotion(config()))
    for step in range(25):
        assert motion.follow(beside_water(step / 10, from_px, step), (1 + step) * STEP_NS, None) is None


@pytest.mark.parametrize("times_a_second", [5.0, 3.3, 1.7])
def test_a_mount_that_shakes_as_no_gyroscope_feels_changes_no_speed(times_a_second: float) -> None:
    """It was measured in a third of the pictures, 0.7 m/s (6.3 standard deviations) too slow."""
    motion, off_mps = known(CameraMotion(config(), turned_rad=lambda since_ns, until_ns: (0.0, 0.0))), []
    for step in range(25):
        pitch_rad = math.radians(0.5) * math.cos(2 * math.pi * times_a_second * step / 10)
        speed = motion.follow(picture(20.0 + STEP_M * step, pitch_rad=pitch_rad), (1 + step) * STEP_NS, None)
        if speed is not None:
            off_mps.append(speed.speed_mps - MPS)
    assert len(off_mps) > 20 and max(map(abs, off_mps)) < 0.03 * MPS and abs(np.mean(off_mps)) < 0.01 * MPS


@pytest.mark.parametrize("lower", [0.9, 0.8])
def test_a_camera_that_sank_after_gps_is_within_what_it_says(lower: float) -> None:
    """It was 9 and 17 standard deviations off."""
    motion = known(CameraMotion(config()))
    for step in range(5):
        speed = motion.follow(picture(20.0 + STEP_M * step, high_m=lower * 1.4), (1 + step) * STEP_NS, None)
    assert speed is not None and speed.speed_mps == pytest.approx(MPS / lower, rel=0.03)
    assert abs(speed.speed_mps - MPS) < 4 * speed.sigma_mps and speed.scale_share <= MOST_SCALE


def test_dirt_on_the_lens_in_the_dark_is_no_halt_and_a_halt_is_one() -> None:
    motion = known(CameraMotion(config()))
    dirt = np.random.default_rng(3).integers(0, 60, (HEIGHT, WIDTH, 3), np.uint8)
    assert drive(motion, 4)[-1] is not None
    seen = [motion.follow(dirt + picture(20.0, light=0.0, seed=n) // 8, (5 + n) * STEP_NS, None) for n in range(20)]
    assert seen == [None] * 20
    assert motion.why == "nothing moves: it stands, or sees no road"
    motion = known(CameraMotion(config()))
    places_m = 20.0 + np.cumsum([0.4, 0.4, 0.4, 0.34, 0.28, 0.22, 0.16, 0.1, 0.04, 0.0, 0.0])
    halt = [motion.follow(picture(at_m, seed=n), n * STEP_NS, None) for n, at_m in enumerate(places_m, start=30)]
    assert halt[-1] is not None and abs(halt[-1].speed_mps) < 3 * halt[-1].sigma_mps + 0.05
