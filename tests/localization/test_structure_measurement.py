"""What structure adds to sequence matches in opposite views, by the estimator of the daemon."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from edge.config import Config, GatesConfig, RigConfig
from edge.localization import Fix, NoFix
from edge.sequence import PlaceMatch
from edge.structure import StructureMatch
from tests.localization.events_of import Road, Sees, Vehicle, left_m, match, north_m, settings
from tests.localization.route_course import SPACING_M

MEASURED = settings(RigConfig(look_sigma_m=0.01))
BACK, LEFT_M, LINE_OFF, SIGMAS = 15, 1.2, 4, (0.4, 0.4)
"""Frames to the middle of the window; how far beside the drive of the map, to the west; places that lines are off."""


def shows(each: int | None = 10, off_m: float = 0.0) -> Sees:
    """Lines that end 8 m ahead of the vehicle, and each some frames structure, which is right but for off_m."""

    def sees(at_m: float) -> PlaceMatch | None:
        place, changes = round(at_m / SPACING_M), dict[str, Any](order="swapped")
        if each and place > 40 and place % each == 0:
            changes["structure"] = StructureMatch(place - BACK, off_m, LEFT_M, BACK, SIGMAS, 0.2)
        return match(place + LINE_OFF, **changes)

    return sees


def driven(road: Road, sees: Sees, config: Config = MEASURED, odometer: float = 1.0) -> Vehicle:
    """After 300 m, without GPS."""
    one = Vehicle(road, config, 20.0)
    one.odometer = odometer
    one.go(300, sees)
    return one


@pytest.mark.parametrize("odometer", [1.0, 0.97])
def test_the_position_is_where_structure_has_it(road: Road, odometer: float) -> None:
    one, alone = (driven(road, sees, odometer=odometer) for sees in (shows(), shows(each=None)))
    assert north_m(one.place) == pytest.approx(one.north_m, abs=1.0)
    assert left_m(one.place) == pytest.approx(LEFT_M, abs=0.5)
    assert north_m(alone.place) - alone.north_m > 4.0
    assert one.place is not None and alone.place is not None
    assert one.place.sigma_along_m < 0.6 * alone.place.sigma_along_m


def test_it_is_handed_on_as_a_pose_is_where_its_errors_are_independent(road: Road) -> None:
    """With what the odometer adds since, which is 3 % wrong; each of 20 m is measured."""
    one = driven(road, shows(), settings(RigConfig(look_sigma_m=0.01), GatesConfig(risk=1.0)), 0.97)
    seen = {one.drive.pose_ns: one.north_m}
    while one.north_m < 400.0 - LINE_OFF * SPACING_M:
        one.go(SPACING_M, shows())
        if one.drive.pose_ns not in seen:
            answer = one.ask(at="pose")
            assert isinstance(answer, Fix) and answer.pose_sigma_m is not None
            assert max(SIGMAS) < answer.pose_sigma_m < 1.0
            assert north_m(answer.place) == pytest.approx(one.north_m, abs=1.5)
            assert left_m(answer.place) == pytest.approx(LEFT_M, abs=0.5)
            seen[one.drive.pose_ns] = one.north_m
    _, *handed = seen.values()
    assert len(handed) == 2 and np.diff(handed) == pytest.approx(40.0)
    assert isinstance(driven(road, shows(each=None)).ask(at="pose"), NoFix)


def test_one_that_is_far_off_is_an_outlier(road: Road) -> None:
    one = driven(road, shows())
    before = one.drive.pose_ns
    one.go(40, shows(off_m=19.0))
    assert north_m(one.place) == pytest.approx(one.north_m, abs=1.5)
    assert one.drive.pose_ns == before


def test_on_the_way_back_left_is_the_other_side(road: Road) -> None:
    """And the window lies behind, further along the drive of the map."""

    def sees(at_m: float) -> PlaceMatch:
        place = round(at_m / SPACING_M)
        seen = StructureMatch(place + BACK, 0.0, LEFT_M, BACK, SIGMAS, 0.2) if place % 10 == 0 else None
        return match(place - LINE_OFF, "reverse", order="same", structure=seen)

    one = Vehicle(road, MEASURED, 380.0, "reverse")
    one.go(300, sees)
    assert north_m(one.place) == pytest.approx(one.north_m, abs=1.0)
    assert left_m(one.place) == pytest.approx(LEFT_M, abs=0.5)
