"""The simulated autopilot errs as the real ones did: recorded flights, replayed."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.sim.vehicle.flight_comparison import FLIGHTS, compare

RUN_AWAY = ("px4_no_velocity_aid_person", "px4_external_position_person")
"""PX4's velocity runs away in them, so that small differences grow; docs/trial.md has the numbers."""


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
