"""The simulated autopilot errs as the real ones did: recorded flights, replayed."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.sim.vehicle.flight_comparison import EVV_NOISE, FLIGHTS, VELOCITY_SENSOR, compare

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
