"""The simulated autopilot errs as the real ones did: recorded flights, replayed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from sim.vehicle.estimator import OdometryErrors
from tests.sim.vehicle.flight_comparison import EVV_NOISE, FAST, FLIGHTS, RIGHT, STEP_S, VELOCITY_SENSOR, compare

pytestmark = pytest.mark.long

RUN_AWAY = ("px4_no_velocity_aid_person", "px4_external_position_person")
"""PX4's velocity runs away in them, so that small differences grow: 0.60 and 1.29 times the recorded error."""


@pytest.mark.parametrize("name", sorted(set(FLIGHTS) - set(RUN_AWAY)))
def test_the_error_is_within_20_percent_of_the_recorded_one(shared: Path, name: str) -> None:
    """Without positions (`daemon_off`) this is how the error grows, and with them how the autopilot responds."""
    folder = shared / "flights" / name
    if not folder.is_dir():
        pytest.skip(f"needs the recorded flight {folder}")
    found = compare(folder, FLIGHTS[name])
    assert found.mean_ratio == pytest.approx(1.0, abs=0.2)
    if not found.fixes:
        assert found.end_ratio == pytest.approx(1.0, abs=0.2)


@pytest.mark.parametrize(("name", "most_m"), [("own_sigma_w921", 5.0), ("w921", 18.0)])
def test_px4_follows_positions_with_their_own_standard_deviation(shared: Path, name: str, most_m: float) -> None:
    """The same vehicle on the same road; without `own_sigma` each message had six times that."""
    folder = shared / "flights_b06f79e" / f"px4_aided_mission_296_{name}"
    if not folder.is_dir():
        pytest.skip(f"needs the recorded flight {folder}")
    found = compare(folder, VELOCITY_SENSOR, EVV_NOISE)
    assert found.mean_ratio == pytest.approx(1.0, abs=0.2)
    assert max(found.real_m.max(), found.simulated_m.max()) < most_m


@pytest.mark.parametrize(
    ("name", "errors", "fixes"),
    [
        ("off971", RIGHT, 0),
        ("dusk974_held", RIGHT, 0),
        ("off974_103", FAST, 0),
        ("a971_held", RIGHT, 1),
        ("a971_103_held", FAST, 5),
        ("a971", RIGHT, 35),
        ("dusk972", RIGHT, 39),
        ("a971_103", FAST, 67),
        ("a974_lines", RIGHT, 126),
    ],
)
def test_what_the_filter_takes_back_is_lost_by_resets_as_recorded(
    shared: Path, name: str, errors: OdometryErrors, fixes: int
) -> None:
    """The same wheels and compass, 2 m off at the end of a road alone, 5 to 18 m with the resets that were sent."""
    folder = shared / "flights_b0903bde" / f"ardupilot_{name}"
    if not folder.is_dir():
        pytest.skip(f"needs the recorded flight {folder}")
    found = compare(folder, errors)
    assert found.fixes == fixes
    real_m, simulated_m = (np.percentile(one, (50, 95, 100)) for one in (found.real_m, found.simulated_m))
    assert simulated_m == pytest.approx(real_m, rel=0.1, abs=0.8)
    assert found.mean_ratio == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize(("name", "recorded_m"), [("off971", (3.0, 5.0)), ("dusk974_held", (2.1, 2.6))])
def test_an_error_to_the_side_alone_grows_as_the_recorded_one(
    shared: Path, name: str, recorded_m: tuple[float, float]
) -> None:
    """Alone, with what has grown ahead taken away each second: in bends the rest no longer cancels."""
    folder = shared / "flights_b0903bde" / f"ardupilot_{name}"
    if not folder.is_dir():
        pytest.skip(f"needs the recorded flight {folder}")
    found = compare(folder, RIGHT)
    assert np.percentile(_to_the_side_m(found.real, found.heading_rad), (50, 95)) == pytest.approx(recorded_m, abs=0.1)
    simulated_m = np.percentile(_to_the_side_m(found.simulated, found.heading_rad), (50, 95))
    assert simulated_m == pytest.approx(recorded_m, abs=0.7)


def _to_the_side_m(errors: NDArray[np.float64], heading_rad: NDArray[np.float64]) -> list[float]:
    """Meters at each moment but the first, of errors (N, 2) whose part ahead goes back to 0 each second."""
    off_m, found_m = errors[0], []
    for step, turned in enumerate(heading_rad[1:], 1):
        off_m = off_m + errors[step] - errors[step - 1]
        if step % round(1.0 / STEP_S) == 0:
            ahead = np.array([np.sin(turned), np.cos(turned)])
            off_m = off_m - ahead * (off_m @ ahead)
        found_m.append(float(np.hypot(*off_m)))
    return found_m
