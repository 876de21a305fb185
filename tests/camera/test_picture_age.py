"""How old pictures are is found from starts and stops, and nothing is found where they are in time."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.camera.picture_check import Age, PictureAge, PictureCheck
from edge.feed import Frame

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


PX_PER_M = 20
ROAD = np.random.default_rng(1).integers(0, 255, (48, 1000 * PX_PER_M)).astype(float)
PLACES_M = np.cumsum([speed_mps(at_s) * FRAME_S for at_s in np.arange(0.0, 130.0, FRAME_S)])


def picture(at_s: float, seed: int) -> NDArray[np.uint8]:
    """A strip of the road, with the noise of a sensor."""
    place_m = PLACES_M[min(max(0, round(at_s / FRAME_S)), len(PLACES_M) - 1)]
    at_px = round(PX_PER_M * place_m)
    noise = np.random.default_rng(seed).normal(0.0, NOISE, (48, 96))
    strip = (ROAD[:, at_px : at_px + 96] + noise).clip(0, 255)
    return np.asarray(strip[..., np.newaxis].repeat(3, axis=2), np.uint8)


def watched(age_s: float, until_s: float, from_s: float = 0.0) -> PictureAge:
    found = PictureAge()
    for number, at_s in enumerate(np.arange(from_s, until_s, FRAME_S)):
        found.add(picture(float(at_s) - age_s, number), round(at_s * SECOND), speed_mps(float(at_s)) >= 0.3)
    return found


@pytest.mark.parametrize("age_s", [3.0, 4.0, 6.0])
def test_a_start_and_a_stop_show_how_old_the_pictures_are(age_s: float) -> None:
    one, two = watched(age_s, 16.0).age, watched(age_s, 36.0).age
    assert not one.is_certain and one.age_ns / 1e9 == pytest.approx(age_s, abs=1.0)
    assert two.is_certain and two.age_ns / 1e9 == pytest.approx(age_s, abs=0.5)


@pytest.mark.parametrize("age_s", [0.0, 0.3])
def test_pictures_in_time_are_never_called_old(age_s: float) -> None:
    found = PictureAge()
    for number, at_s in enumerate(np.arange(0.0, 120.0, FRAME_S)):
        found.add(picture(float(at_s) - age_s, number), round(at_s * SECOND), speed_mps(float(at_s)) >= 0.3)
        assert found.age == Age()


def test_a_vehicle_that_never_stops_and_one_whose_speed_is_unknown_show_nothing() -> None:
    assert watched(3.0, 24.0, from_s=8.0).age == Age()
    found = PictureAge()
    for number in range(400):
        found.add(picture(number * FRAME_S - 3.0, number), round(number * FRAME_S * SECOND), None)
    assert found.age == Age()


def test_pictures_whose_age_is_not_certain_are_not_used_and_certain_ones_get_their_own_stamps() -> None:
    check = PictureCheck(None, 0.3)
    usable, corrected = [], []
    for number, at_s in enumerate(np.arange(0.0, 45.0, FRAME_S)):
        frame = Frame(picture(float(at_s) - 3.0, number), round(at_s * SECOND), number)
        dated = check.dated(frame, speed_mps(float(at_s)))
        usable.append(check.is_usable(dated, speed_mps(float(at_s))))
        corrected.append((frame.stamp_ns - dated.stamp_ns) / 1e9)
    assert usable[100] and not usable[200] and usable[-1]
    assert corrected[200] == 0.0 and corrected[-1] == pytest.approx(3.0, abs=0.5)
