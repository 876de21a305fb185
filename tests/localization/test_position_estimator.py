"""What the estimator joins: GPS is compared with a place only where the vehicle heads along its road."""

from __future__ import annotations

import ast
import math
from pathlib import Path

import pytest
from edge.localization.report import Report
from msgspec.structs import replace

from edge.config import RigConfig
from edge.geodesy import VehiclePosition
from edge.localization import GpsFix, PlaceFix
from edge.localization.position_estimator import PositionEstimator
from edge.reference_map import MapSet
from tests.localization.straight_road import LAT_DEG, METRE_DEG, SPACING_M, match, settings

TURNED_AT, FRAMES = 110, 40
ROOT = Path(__file__).parents[2]
PARTS = "Integrity", "RouteFilter"


@pytest.mark.parametrize(("heading_deg", "is_called"), [(0.0, False), (None, True)])
def test_a_match_that_turns_where_the_vehicle_goes_on_says_nothing_of_gps(
    map_set: MapSet, heading_deg: float | None, is_called: bool
) -> None:
    """A drive that turned round is in the map; matches follow it back for a while, and GPS goes on with the vehicle.

    Without a heading, an honest GPS is called wrong.
    """
    estimator = PositionEstimator(settings(RigConfig()))
    estimator.use_maps(map_set)

    def judged(place: int, direction: str, seen: int) -> str:
        gps = GpsFix(LAT_DEG + place * SPACING_M * METRE_DEG, 153.0, 1.0)
        report = Report(0, position=VehiclePosition(0, gps.lat_deg, gps.lon_deg, 0.0, heading_deg, 8.0))
        return estimator.update(match(seen, direction), 0, None, report, gps).state

    states = [judged(place, "forward", place) for place in range(30, TURNED_AT)]
    assert states[-1] == "agrees"
    turned = [judged(TURNED_AT + far, "reverse", TURNED_AT - far) for far in range(FRAMES)]
    assert ("wrong" in turned) == is_called


def test_a_position_that_has_run_away_is_known_again_once_gps_bounds_it() -> None:
    estimator = PositionEstimator(settings(RigConfig()))
    known_m = []
    for gps_sigma_m, is_aided in ((3.0, True), (None, False), (None, True), (3.0, True)):
        report = Report(0, gps_sigma_m=gps_sigma_m, driven_m=100.0, is_aided=is_aided)
        estimator.bind_by_gps(report)
        known_m.append(estimator.uncertainty_m(report))
    assert known_m == [3.0, None, None, 3.0]


def test_the_autopilot_is_uncertain_by_what_its_velocity_was_found_wrong_by_last() -> None:
    estimator, after = PositionEstimator(settings(RigConfig())), Report(0, driven_m=100.0)
    estimator.bind_by_gps(Report(0, gps_sigma_m=3.0, driven_m=0.0))
    fix, known_m = PlaceFix(0, 7, LAT_DEG, 153.0, 0.0, 3.0, 2.0, "forward", "same", 1.3, "street"), []
    for error in (0.1, 0.2, 0.15):
        estimator.observe(replace(fix, velocity_error=error), after, None)
        known_m.append(estimator.uncertainty_m(after))
    assert known_m == pytest.approx([math.hypot(3.0, of_m) for of_m in (10.0, 20.0, 15.0)])


def test_positions_are_estimated_in_one_place() -> None:
    """The daemon, the trial, the replays and the hours of the protection level put nothing together themselves."""
    found = set()
    bench = ROOT / "tests" / "localization"
    for path in (
        *ROOT.glob("edge/**/*.py"),
        *ROOT.glob("sim/**/*.py"),
        bench / "route_bench.py",
        bench / "level_hours.py",
    ):
        calls = (node.func for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call))
        if any(isinstance(called, ast.Name) and called.id in PARTS for called in calls):
            found.add(path.name)
    assert found == {"position_estimator.py"}
