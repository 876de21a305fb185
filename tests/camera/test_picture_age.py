"""How old a stream's pictures are is found from turns; a camera that stamps them is believed."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from itertools import groupby

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from edge.camera.checks import open_picture_check
from edge.camera.newest import NewestFrame
from edge.camera.picture_age import SIGMA_NS, UNDATED, Age, PictureAge
from edge.camera.picture_check import FROZEN
from edge.feed import Frame
from edge.geodesy import VehiclePosition
from tests.common import S

FRAME_S = 0.1
NOISE = 5.0
PLATE = np.random.default_rng(3).normal(0.0, NOISE, (480, 640)).astype(np.float32)


def noise(seed: int, high: int, wide: int) -> NDArray[np.float32]:
    """Of a sensor, from another part of one plate for each picture, since random numbers take most of the time."""
    top, left = seed * 37 % (480 - high), seed * 101 % (640 - wide)
    return PLATE[top : top + high, left : left + wide]


def known(found: PictureAge) -> Age:
    """What is known of the age."""
    assert found.age is not None
    return found.age


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
        heading = round(heading_s * S), heading_deg(heading_s) % 360
        found.add(ahead(at_s - age_s, number, faces_deg), round(at_s * S), heading)
    return found


def late_frames(age_s: float, until_s: float) -> Iterator[tuple[Frame, VehiclePosition]]:
    """Pictures that are so old, and where the vehicle was when they arrived."""
    for number, at_s in enumerate(np.arange(0.0, until_s, FRAME_S).tolist()):
        frame = Frame(ahead(at_s - age_s, number), round(at_s * S), number)
        yield frame, VehiclePosition(frame.stamp_ns, 0.0, 0.0, 0.0, heading_deg(at_s) % 360, 0.0, 0.0, 8.0)


@pytest.mark.parametrize("kind", ["v4l2", "oak", "sim", "feed"])
def test_a_camera_whose_driver_stamps_its_pictures_is_believed(kind: str) -> None:
    """Pictures that were in time seemed 2.3 and 5.4 s old on recorded drives, and no position was sent."""
    check = open_picture_check(None, kind, 0.3)
    for frame, own in late_frames(3.0, 45.0):
        assert check.dated(frame, 8.0, own) is frame
        assert check.is_usable(frame, None)
    assert (check.why_no_position, check.stamp_sigma_s) == ("", 0.0)


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
    turns = known(turned(age_s, 30.0))
    assert abs(turns.age_ns / 1e9 - age_s) <= 2 * turns.sigma_ns / 1e9 <= 1.1


def test_an_age_that_is_not_worth_a_correction_is_in_the_standard_deviation() -> None:
    age = known(turned(0.02, 30.0))
    assert age.age_ns == 0 and age.sigma_ns > 1.05 * SIGMA_NS


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
        frame = Frame(ahead(at_s - (0.7 if at_s < 30.0 else 3.0), number), round(at_s * S), number)
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
    for frame, own in late_frames(0.0, 30.0):
        stream.is_usable(stream.dated(frame, 8.0, own), 8.0)
    assert stream.why_no_position == ""
    for number in range(30):
        stream.is_usable(Frame(frame.image, frame.stamp_ns + number * S, number), 8.0)
    assert (stream.why_no_position, stream.why_undated) == (FROZEN, "")


class Endless:
    """A camera that always has a picture."""

    differences: tuple[str, ...] = ()
    read_timeout_s = 10.0

    def read(self) -> Frame:
        time.sleep(0.01)
        return Frame(ahead(0.0, 0), time.monotonic_ns(), 0)

    def close(self) -> None:
        pass


def test_of_a_stream_that_was_opened_again_the_age_is_not_known() -> None:
    device = NewestFrame(Endless, first_back_off_s=0.0)
    check = open_picture_check(device, "stream", 0.3)
    for frame, own in late_frames(0.0, 30.0):
        check.dated(frame, 8.0, own)
    assert check.why_no_position == ""
    device.reopen("its host is another one")
    while device.health.reopened == 0:
        device.take(1.0)
    check.dated(Frame(ahead(31.0, 0), 31 * S, 0), 8.0)
    assert check.why_no_position == UNDATED
    device.close()
