"""What would be published without GPS: GPS, which judges it, must have no part in it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest

from edge.geodesy import east_north_of
from edge.localization import DeadReckoning
from edge.telemetry.position_history import PositionHistory
from edge.telemetry.shadow import Shadow, ShadowPosition
from tests.localization.events_of import SPEED_MPS, Road, Vehicle, settings
from tests.localization.route_course import HOME, Stretch


@pytest.fixture(scope="module")
def road(tmp_path_factory: pytest.TempPathFactory) -> Road:
    return Road(tmp_path_factory.mktemp("road"), Stretch(0, 600, sigma_m=1.0))


class Shadowed(Vehicle):
    """Drives beside GPS with a shadow."""

    def __init__(self, road: Road) -> None:
        self.records: list[Any] = []
        self.shadow = Shadow(settings(), self.records.append)
        super().__init__(road, listeners=[self.shadow.update])
        self.history, self.speeds, self.unable = PositionHistory(lambda: self.t_ns), DeadReckoning(), ""

    def follow(self, meters: float, sees: Any = None) -> list[ShadowPosition]:
        """The records of a way beside GPS."""
        before = len(self.records)
        for _ in range(round(meters / 2)):
            self.go(2, sees, gps=True)
            self.history.add(replace(self.position, sigma_m=0.5, source="rtk_fixed"))
            self.speeds.add_speed(self.t_ns, SPEED_MPS, 0)
            self.shadow.turn(self.t_ns, self.speeds, self.history, lambda: self.unable)
        return self.records[before:]


def norths_m(records: list[ShadowPosition]) -> Iterator[float]:
    for one in records:
        if not one.withheld:
            assert one.lat_deg is not None and one.lon_deg is not None
            yield east_north_of(one.lat_deg, one.lon_deg, HOME)[1]


def test_a_position_a_second_beside_gps_and_why_there_is_none(road: Road) -> None:
    one = Shadowed(road)
    found = one.follow(300)
    assert len(found) == pytest.approx(300 / SPEED_MPS, abs=3)
    assert found[0].withheld == "recognized, but not exactly"
    assert not any(record.withheld for record in found[-5:])
    newest = found[-1]
    assert (newest.gps_sigma_m, newest.gps_source, newest.direction) == (0.5, "rtk_fixed", "forward")
    assert next(norths_m([newest])) == pytest.approx(one.north_m, abs=12), "at its exposure, not before"
    one.unable = "the pictures are dark"
    assert {record.withheld for record in one.follow(100)} == {"nothing is recognized now: the pictures are dark"}


@pytest.mark.parametrize("off_m", [-6.0, 6.0])
def test_a_gps_that_is_wrong_does_not_move_what_it_judges(off_m: float, road: Road) -> None:
    """The estimator that knows of GPS is drawn to it by meters."""
    honest, wrong = Shadowed(road), Shadowed(road)
    wrong.off_m = off_m
    by_places, beside_wrong = list(norths_m(honest.follow(300))), list(norths_m(wrong.follow(300)))
    assert len(by_places) > 10 and beside_wrong == pytest.approx(by_places[-len(beside_wrong) :], abs=0.01)
    newest = wrong.records[-1]
    gps_m = east_north_of(newest.gps_lat_deg, newest.gps_lon_deg, HOME)[1]
    assert gps_m - beside_wrong[-1] == pytest.approx(off_m, abs=1.5)


def test_a_place_that_is_believed_because_gps_is_near_it_counts_as_none(road: Road) -> None:
    one = Shadowed(road)

    def by_gps(at_m: float) -> Any:
        found = road.match(at_m)
        return found and replace(found, by_votes=replace(found, accepted=False))

    assert not one.follow(250)[-1].withheld
    assert {record.withheld for record in one.follow(100, by_gps)[-5:]} == {"the places do not agree yet"}
