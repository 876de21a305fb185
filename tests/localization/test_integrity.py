"""Every rule that holds a position back, one at a time, from a situation in which nothing does."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import msgspec
import pytest

from edge.config import GatesConfig
from edge.geodesy import VehiclePosition
from edge.localization import PlaceFix
from edge.localization.integrity import Refusal, Situation, Uncertainty, distance_from, refusal

S = 1_000_000_000
NOW_NS = 100 * S
METRE_DEG = 1 / 111_320
GATES = GatesConfig()
FIX = PlaceFix(NOW_NS - S, 7, 0.0, 10.0, 0.0, 3.0, 2.0, "forward", "same", 1.3, "street", matches=5)
OWN = VehiclePosition(NOW_NS - S, 0.0, 10.0, 20.0, 0.0, 10.0)
MOVING = Situation(NOW_NS, "not healthy", 10.0, OWN, 4.0, None)  # combined deviation 5 m


def north(meters: float) -> PlaceFix:
    return msgspec.structs.replace(FIX, lat_deg=meters * METRE_DEG)


def judged(fix: PlaceFix = FIX, gates: GatesConfig = GATES, **changes: Any) -> str | None:
    refused = refusal(fix, replace(MOVING, **changes), gates, 1.0, 5.0)
    return refused.reason if refused else None


def test_a_good_fix_passes() -> None:
    assert judged() is None


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"gps": "healthy"}, "GPS is healthy"),
        ({"gps": "unknown"}, "GPS is unknown"),
        ({"speed_mps": 0.2}, "standing"),
        ({"last_sent_ns": NOW_NS - S // 2}, "too soon"),
        ({"now_ns": NOW_NS + 5 * S}, "too old"),
        ({"now_ns": NOW_NS - 2 * S}, "too old"),
    ],
)
def test_situations_in_which_nothing_goes(changes: dict[str, Any], reason: str) -> None:
    assert judged(**changes) == reason


def test_gps_does_not_matter_to_who_asked_for_fixes_with_it() -> None:
    assert judged(gates=GatesConfig(with_gps=True), gps="healthy") is None


def test_a_map_without_positions_and_a_first_match() -> None:
    assert judged(msgspec.structs.replace(FIX, lat_deg=None, lon_deg=None)) == "no position in the map"
    assert judged(msgspec.structs.replace(FIX, matches=4)) == "too few matches in a row"


@pytest.mark.parametrize(
    ("meters", "matches", "reason"),
    [
        (14.0, 5, None),
        (16.0, 5, "too few matches for a far fix"),
        (16.0, 11, "too few matches for a far fix"),
        (16.0, 12, None),
        (49.0, 12, None),
        (51.0, 500, "impossibly far"),
    ],
)
def test_the_distance_counts_in_deviations_of_both(meters: float, matches: int, reason: str | None) -> None:
    assert judged(msgspec.structs.replace(north(meters), matches=matches)) == reason


@pytest.mark.parametrize("unknown", [{"position": None}, {"uncertainty_m": None}])
def test_where_nothing_is_known_of_the_vehicle_many_matches_and_another_place_count(unknown: dict[str, Any]) -> None:
    far = north(5000.0)
    assert judged(far, **unknown) == "too few matches for a far fix"
    sure = msgspec.structs.replace(far, matches=12)
    assert judged(sure, **unknown) == "not confirmed by another place yet"
    assert judged(sure, **unknown, confirmed=True) is None


def test_a_refusal_says_how_far() -> None:
    refused = refusal(north(100.0), MOVING, GATES, 1.0, 5.0)
    assert isinstance(refused, Refusal)
    assert refused.distance_m == pytest.approx(100.0, rel=0.01)


def test_the_autopilots_position_is_taken_back_to_the_exposure() -> None:
    later = replace(OWN, stamp_ns=NOW_NS, lat_deg=10.0 * METRE_DEG, north_mps=10.0)
    assert distance_from(later, FIX) == pytest.approx(0.0, abs=0.1)


def test_uncertainty_grows_with_the_distance_since_it_was_bound() -> None:
    uncertainty = Uncertainty(drift_percent=5.0)
    assert uncertainty.at(100.0, None) is None
    assert uncertainty.at(100.0, 7.0) == 7.0, "what the autopilot says is better than nothing"
    uncertainty.bind(3.0, 100.0)
    assert uncertainty.at(100.0, None) == 3.0
    assert uncertainty.at(180.0, None) == pytest.approx(5.0)
    assert uncertainty.at(180.0, 9.0) == 9.0, "the larger one"
    assert uncertainty.at(None, None) is None
    uncertainty.bind(3.0, None)
    assert uncertainty.at(180.0, None) == pytest.approx(5.0), "nothing is bound without an odometer"
    uncertainty.reset()
    assert uncertainty.at(180.0, None) is None
