"""How old a stream's pictures are is found from starts, stops and turns; a camera that stamps them is believed."""

from __future__ import annotations

import math
import time
from itertools import groupby
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from edge.camera.checks import open_picture_check
from edge.camera.newest import NewestFrame
from edge.camera.picture_age import MOVES_SIGMA_NS, UNDATED, Age, PictureAge, Starts
from edge.camera.picture_check import FROZEN
from edge.feed import Frame
from edge.geodesy import VehiclePosition

SECOND, FRAME_S = 1_000_000_000, 0.1
NOISE = 5.0
HALTS = ((0.0, 5.0), (25.0, 40.0), (60.0, 68.0), (90.0, 95.0))
"""Seconds from when to when the vehicle stands."""


def speed_mps(at_s: float) -> float:
    """At 1.5 m/s^2 up to 8 m/s after each halt, and as fast down to the next one."""
    if any(begins <= at_s < ends for begins, ends in HALTS):
        return 0.0
    since_s = min((at_s - ends for _, ends in HALTS if at_s >= ends), default=99.0)
    until_s = min((begins - at_s for begins, _ in HALTS if at_s < begins), default=99.0)
    return min(8.0, 1.5 * since_s, 1.5 * until_s)


PLATE = np.random.default_rng(3).normal(0.0, NOISE, (480, 640)).astype(np.float32)


def noise(seed: int, high: int, wide: int) -> NDArray[np.float32]:
    """Of a sensor, from another part of one plate for each picture, since random numbers take most of the time."""
    top, left = seed * 37 % (480 - high), seed * 101 % (640 - wide)
    return PLATE[top : top + high, left : left + wide]


PX_PER_M = 20
ROAD = np.random.default_rng(1).integers(0, 255, (48, 1000 * PX_PER_M)).astype(np.float32)
PLACES_M = np.cumsum([speed_mps(at_s) * FRAME_S for at_s in np.arange(0.0, 130.0, FRAME_S)])


def picture(at_s: float, seed: int, crept_m: float = 0.0) -> NDArray[np.uint8]:
    """A strip of the road, with the noise of a sensor."""
    place_m = crept_m + PLACES_M[min(max(0, round(at_s / FRAME_S)), len(PLACES_M) - 1)]
    at_px = round(PX_PER_M * place_m)
    strip = (ROAD[:, at_px : at_px + 96] + noise(seed, 48, 96)).clip(0, 255)
    return np.asarray(strip[..., np.newaxis].repeat(3, axis=2), np.uint8)


def watched(age_s: float, until_s: float, from_s: float = 0.0) -> PictureAge:
    found = PictureAge()
    for number, at_s in enumerate(np.arange(from_s, until_s, FRAME_S)):
        found.add(picture(float(at_s) - age_s, number), round(at_s * SECOND), speed_mps(float(at_s)) >= 0.3)
    return found


def known(found: PictureAge) -> Age:
    """What is known of the age."""
    assert found.age is not None
    return found.age


@pytest.mark.parametrize("age_s", [3.0, 4.0, 6.0])
def test_an_age_that_is_hardly_plausible_must_be_seen_twice(age_s: float) -> None:
    assert watched(age_s, 16.0).age is None
    assert known(watched(age_s, 36.0)).age_ns / 1e9 == pytest.approx(age_s, abs=0.5)


def test_a_start_of_a_recorded_drive_shows_that_its_pictures_are_in_time() -> None:
    """They seemed 2.3 s old: the vehicle began at 1 m/s2, by night, in an open place."""
    start = np.genfromtxt(Path(__file__).with_name("start_by_night.csv"), delimiter=",", names=True)
    dither = np.random.default_rng(4).random((48, 96))
    found, gray, sign = PictureAge(), 40.0, 1
    for at_s, change, mps in start:
        sign = -sign if not 40.0 <= gray + sign * change <= 200.0 else sign
        gray += sign * change
        image = np.floor(gray + dither).astype(np.uint8)[..., np.newaxis].repeat(3, axis=2)
        found.add(image, round((at_s + 100) * SECOND), bool(mps >= 0.3))
    assert known(found).age_ns <= 0.31 * SECOND


def test_a_vehicle_that_never_stops_and_one_whose_speed_is_unknown_show_nothing() -> None:
    assert watched(3.0, 24.0, from_s=8.0).age is None
    found = PictureAge()
    for number in range(400):
        found.add(picture(number * FRAME_S - 3.0, number), round(number * FRAME_S * SECOND), None)
    assert found.age is None


@pytest.mark.parametrize("kind", ["v4l2", "oak", "sim", "feed"])
def test_a_camera_whose_driver_stamps_its_pictures_is_believed(kind: str) -> None:
    """Pictures that were in time seemed 2.3 and 5.4 s old on recorded drives, and no position was sent."""
    check = open_picture_check(None, kind, 0.3)
    for number, at_s in enumerate(np.arange(0.0, 45.0, FRAME_S)):
        frame = Frame(picture(float(at_s) - 3.0, number), round(at_s * SECOND), number)
        assert check.dated(frame, speed_mps(float(at_s))) is frame
        assert check.is_usable(frame, speed_mps(float(at_s)))
    assert (check.why_no_position, check.stamp_sigma_s) == ("", 0.0)


def heading_deg(at_s: float) -> float:
    """Bends of different lengths, up to 16 degrees a second; straight on from 75 s to 115 s."""
    at_s = min(at_s, 75.0)
    return 40 * math.sin(at_s / 5) + 15 * math.sin(at_s / 1.9 + 1) + 20 * math.sin(at_s / 11)


PX_PER_DEG = 4
ROUND = cv2.GaussianBlur(
    np.random.default_rng(2).integers(0, 255, (240, 720 * PX_PER_DEG)).astype(np.float32), (0, 0), 6
)
ROUND = (ROUND - ROUND.mean()) * 8 + 128


def ahead(at_s: float, seed: int, faces_deg: float | None = None) -> NDArray[np.uint8]:
    """What a camera sees that turns as the vehicle does, with the noise of a sensor."""
    at_px = round(PX_PER_DEG * (360 + (heading_deg(at_s) if faces_deg is None else faces_deg)))
    view = (ROUND[:, at_px - 160 : at_px + 160] + noise(seed, 240, 320)).clip(0, 255)
    return np.asarray(view[..., np.newaxis].repeat(3, axis=2), np.uint8)


def turned(
    age_s: float, until_s: float, from_s: float = 0.0, faces_deg: float | None = None, found: PictureAge | None = None
) -> PictureAge:
    """Of a vehicle that never stops, whose heading comes three times a second."""
    found = found or PictureAge()
    for number, at_s in enumerate(np.arange(from_s, until_s, FRAME_S).tolist()):
        heading_s = at_s - at_s % 0.3
        heading = round(heading_s * SECOND), heading_deg(heading_s) % 360
        found.add(ahead(at_s - age_s, number, faces_deg), round(at_s * SECOND), True, heading)
    return found


@pytest.mark.parametrize("age_s", [2.5, 3.0, 6.0])
def test_turns_show_how_old_the_pictures_of_a_vehicle_are_that_never_stops(age_s: float) -> None:
    found = turned(age_s, 30.0)
    assert found.age is None
    turned(age_s, 50.0, 30.0, found=found)
    certain = known(found)
    assert certain.age_ns / 1e9 == pytest.approx(age_s, abs=0.25)
    turned(age_s, 72.0, 50.0, found=found)
    assert known(found).age_ns == certain.age_ns


@pytest.mark.parametrize("age_s", [0.0, 0.3, 0.7])
def test_the_age_of_a_streams_pictures_is_found_within_its_standard_deviation(age_s: float) -> None:
    """Pictures that were 1 and 1.5 s old counted as in time: positions were up to 19 m and 8.3 sigma off."""
    start = known(watched(age_s, 16.0))
    assert abs(start.age_ns / 1e9 - age_s) <= 2 * start.sigma_ns / 1e9 <= 1.4
    turns = known(turned(age_s, 30.0))
    assert abs(turns.age_ns / 1e9 - age_s) <= 2 * turns.sigma_ns / 1e9 <= 1.1


def test_an_age_that_is_not_worth_a_correction_is_in_the_standard_deviation() -> None:
    age = known(watched(0.3, 16.0))
    assert age.age_ns == 0 and age.sigma_ns > 1.05 * MOVES_SIGMA_NS


def test_an_age_that_contradicts_the_known_one_must_be_seen_twice() -> None:
    found = turned(0.7, 30.0)
    before = known(found)
    turned(3.0, 55.0, 30.0, found=found)
    assert found.age == before
    turned(3.0, 72.0, 55.0, found=found)
    assert known(found).age_ns / 1e9 == pytest.approx(3.0, abs=0.25)


def test_stamps_stay_corrected_while_an_age_that_was_seen_once_contradicts_them() -> None:
    check, corrected = open_picture_check(None, "stream", 0.3), []
    for number, at_s in enumerate(np.arange(0.0, 72.0, FRAME_S).tolist()):
        frame = Frame(ahead(at_s - (0.7 if at_s < 30.0 else 3.0), number), round(at_s * SECOND), number)
        own = VehiclePosition(frame.stamp_ns, 0.0, 0.0, 0.0, heading_deg(at_s) % 360, 0.0, 0.0, 8.0)
        corrected.append(round((frame.stamp_ns - check.dated(frame, 8.0, own).stamp_ns) / 1e9, 1))
        check.is_usable(frame, 8.0)
    assert [age_s for age_s, _ in groupby(corrected)] == [
        0.0,
        pytest.approx(0.7, abs=0.25),
        pytest.approx(3.0, abs=0.25),
    ]


def test_where_the_road_is_straight_or_the_camera_turns_otherwise_nothing_is_known() -> None:
    for straight in (turned(0.5, 115.0, from_s=78.0), turned(0.5, 40.0, faces_deg=0.0)):
        assert straight.age is None


def test_no_position_rests_on_a_stream_before_its_age_is_known() -> None:
    stream, camera = (open_picture_check(None, kind, 0.3) for kind in ("stream", "v4l2"))
    assert (stream.why_no_position, camera.why_no_position) == (UNDATED, "")
    for number, at_s in enumerate(np.arange(0.0, 16.0, FRAME_S)):
        frame = Frame(picture(float(at_s), number), round(at_s * SECOND), number)
        stream.is_usable(stream.dated(frame, speed_mps(float(at_s))), speed_mps(float(at_s)))
    assert stream.why_no_position == ""
    for number in range(30):
        stream.is_usable(Frame(frame.image, frame.stamp_ns + number * SECOND, number), 8.0)
    assert (stream.why_no_position, stream.why_undated) == (FROZEN, "")


class Endless:
    """A camera that always has a picture."""

    differences: tuple[str, ...] = ()
    read_timeout_s = 10.0

    def read(self) -> Frame:
        time.sleep(0.01)
        return Frame(picture(0.0, 0), time.monotonic_ns(), 0)

    def close(self) -> None:
        pass


def test_of_a_stream_that_was_opened_again_the_age_is_not_known() -> None:
    device = NewestFrame(Endless, first_back_off_s=0.0)
    check = open_picture_check(device, "stream", 0.3)
    for number, at_s in enumerate(np.arange(0.0, 16.0, FRAME_S)):
        check.dated(Frame(picture(float(at_s), number), round(at_s * SECOND), number), speed_mps(float(at_s)))
    assert check.why_no_position == ""
    device.reopen("its host is another one")
    while device.health.reopened == 0:
        device.take(1.0)
    check.dated(Frame(picture(17.0, 0), 17 * SECOND, 0), 8.0)
    assert check.why_no_position == UNDATED
    device.close()


def shown(age_s: float, times_s: NDArray[np.float64], crept_mps: float = 0.0) -> list[int]:
    """The ages that starts and stops show in pictures of these moments, of a vehicle that creeps until 40 s."""
    starts, found = Starts(), []
    for number, at_s in enumerate(times_s.tolist()):
        seen_s = at_s - age_s
        crept_m = crept_mps * (min(seen_s, 40.0) // 0.2)  # in every other picture
        image = picture(seen_s, number, crept_m)[..., 1]
        found.append(starts.add(image, round(at_s * SECOND), speed_mps(at_s) >= 0.3))
    return [one for one in found if one is not None]


@pytest.mark.parametrize("hole_s", [(6.3, 8.8), (4.8, 6.8)], ids=["of the pictures' start", "of the vehicle's start"])
def test_a_start_that_a_hole_in_the_pictures_hides_shows_nothing(hole_s: tuple[float, float]) -> None:
    """Pictures that are 3 s old would seem 1.3 to 1.8 s old."""
    times_s = np.arange(0.0, 24.0, FRAME_S)
    assert shown(3.0, times_s)
    assert not shown(3.0, times_s[(times_s <= hole_s[0]) | (times_s >= hole_s[1])])


def test_a_start_after_creeping_shows_nothing() -> None:
    """A vehicle that steers itself creeps to where it is to wait, more slowly than what counts as moving."""
    times_s = np.arange(26.0, 51.0, FRAME_S)
    assert shown(3.0, times_s)
    assert not any(shown(age_s, times_s, crept_mps=0.2) for age_s in (0.0, 1.5, 3.0))
