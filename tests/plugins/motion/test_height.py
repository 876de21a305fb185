"""The camera's height: what GPS, places and earlier drives say of it, and how far each can be wrong."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from edge_plugins.motion.height import (
    EARLIER_SHARE,
    WINDOW_M,
    CameraHeight,
    HeightRecord,
    SequencePosition,
    read_height,
)
from edge_plugins.motion.velocity_sender import MOST_SCALE

TRUE_M, STEP_M, STEP_NS, FRAMES = 1.4, 2.0, 200_000_000, 40
BACK = (FRAMES - 1) / 2


def height(*, earlier_m: float | None = None) -> CameraHeight:
    return CameraHeight(HeightRecord("camera", 0.0, () if earlier_m is None else (earlier_m,) * 25), FRAMES)


class Ride:
    """A drive at 10 m/s, a frame every 2 m, with lines whose errors are as large as those of matches."""

    def __init__(self, camera: CameraHeight, seed: int = 0) -> None:
        self.camera, self.at_m, self.now_ns, self.true_m = camera, 0.0, 10**9, TRUE_M
        self._rng, self._off_m = np.random.default_rng(seed), 0.0

    def drive(self, length_m: float, *, gps: bool = False, drive: str = "out", map_scale: float = 1.0) -> None:
        for _ in range(round(length_m / STEP_M)):
            self.at_m, self.now_ns = self.at_m + STEP_M, self.now_ns + STEP_NS
            self.camera.drive(STEP_M / self.true_m / (STEP_NS / 1e9), self.now_ns)
            if gps:
                self.camera.compare(STEP_M, STEP_M / self.true_m, (0.0, 0.0), self.now_ns)
            kept = math.exp(-STEP_M / 60)
            self._off_m = kept * self._off_m + math.sqrt(1 - kept**2) * float(self._rng.normal(0, 3.5))
            along_m = map_scale * (self.at_m - BACK * STEP_M) + self._off_m + float(self._rng.normal(0, 1.5))
            self.camera.use_frame(SequencePosition(drive, 1000 + along_m, BACK) if drive else None)


def off(camera: CameraHeight) -> float:
    assert camera.height_m is not None
    return camera.height_m / TRUE_M - 1


def test_two_windows_of_gps_make_it_known_and_say_more_than_what_an_earlier_drive_found() -> None:
    camera = height()
    road = Ride(camera)
    road.drive(1.5 * WINDOW_M, gps=True, drive="")
    assert camera.height_m is None
    road.drive(WINDOW_M, gps=True, drive="")
    assert abs(off(camera)) < 0.001 and camera.share < 0.03
    camera = height(earlier_m=1.1 * TRUE_M)
    Ride(camera).drive(WINDOW_M + STEP_M, gps=True, drive="")
    assert abs(off(camera)) < 0.01 and camera.share < 0.03


def test_what_an_earlier_drive_found_is_an_odometer_but_not_for_an_autopilot() -> None:
    camera = height(earlier_m=1.1 * TRUE_M)
    assert off(camera) == pytest.approx(0.1)
    assert camera.share >= EARLIER_SHARE > MOST_SCALE


def test_places_correct_what_an_earlier_drive_found_until_it_may_be_sent_as_honestly_as_it_says() -> None:
    sigmas = []
    for seed in range(20):
        camera = height(earlier_m=1.1 * TRUE_M)
        road = Ride(camera, seed)
        sent_m = 0.0
        for _ in range(20):
            road.drive(20.0)
            if camera.share <= MOST_SCALE:
                sent_m = sent_m or road.at_m
                sigmas.append(off(camera) / camera.share)
        assert 100 < sent_m < 300 and abs(off(camera)) < 0.03
    assert np.sqrt(np.mean(np.square(sigmas))) < 1.2 and np.abs(sigmas).max() < 3


def test_a_camera_that_sinks_after_gps_is_contradicted_by_places_and_corrected() -> None:
    for seed in range(10):
        camera = height()
        road = Ride(camera, seed)
        road.drive(200.0, gps=True)
        road.true_m = TRUE_M / 1.1
        road.drive(400.0)
        found = camera.height_m
        assert found is not None and found * 1.1 / TRUE_M == pytest.approx(1.0, abs=0.06)


@pytest.mark.parametrize("sinks", [1.1, 1.25])
def test_a_camera_that_sinks_is_within_what_it_says_and_gps_measures_it_anew(sinks: float) -> None:
    for seed in range(5):
        camera = height()
        road = Ride(camera, seed)
        road.drive(200.0, gps=True)
        road.true_m = TRUE_M / sinks
        for _ in range(20):
            road.drive(20.0)
            found = camera.height_m
            assert found is not None and abs(found - road.true_m) < 4.3 * camera.share * found
        road.true_m = TRUE_M
        road.drive(3 * WINDOW_M + STEP_M, gps=True)
        assert abs(off(camera)) < 0.02 and camera.share < 0.03


def test_while_gps_measures_it_places_say_nothing_though_a_map_be_a_tenth_too_long() -> None:
    camera = height()
    Ride(camera).drive(400.0, gps=True, map_scale=1.1)
    assert abs(off(camera)) < 0.005


def test_comparisons_that_differ_are_less_certain_and_one_that_is_wrong_is_no_matter() -> None:
    assert abs(off(compared(1.4, 1.41, 1.39, 1.4, 2.8))) < 0.01
    assert compared(1.0, 1.4, 1.8, 1.1, 1.7).share > 3 * compared(1.38, 1.4, 1.42, 1.39, 1.41).share


def compared(*heights_m: float) -> CameraHeight:
    camera = height()
    for height_m in heights_m:
        camera.compare(WINDOW_M, WINDOW_M / height_m, (0.0, 0.0), 0)
    return camera


def test_places_of_another_drive_or_elsewhere_and_a_stretch_that_was_not_seen_begin_anew() -> None:
    camera = height(earlier_m=1.1 * TRUE_M)
    road = Ride(camera)
    for turn in range(10):
        road.drive(40.0, drive=f"drive {turn}")
    assert camera.share > MOST_SCALE
    for turn in range(10):
        road.at_m = 1000.0 * turn
        road.drive(40.0)
    assert camera.share > MOST_SCALE
    for _ in range(10):
        road.now_ns += 3 * 10**9
        road.drive(100.0)
    assert camera.share > MOST_SCALE, "of each hundred meters, forty show nothing before a line is complete"


def test_it_is_kept_for_the_same_camera(tmp_path: Path) -> None:
    path = tmp_path / "events.height"
    path.write_text('{"camera": "camera", "pitch_rad": 0.1, "heights_m": [1.4, 1.4]}')
    assert read_height(path, "camera", 0.0) == HeightRecord("camera", 0.1, (1.4, 1.4))
    nothing = HeightRecord("another", 0.2)
    assert read_height(path, "another", 0.2) == nothing
    path.write_text('{"camera": 3}')
    assert read_height(path, "another", 0.2) == nothing == read_height(None, "another", 0.2)
