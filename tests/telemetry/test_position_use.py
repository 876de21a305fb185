"""What is concluded from an autopilot that is near its positions, and from one that does not answer."""

from __future__ import annotations

from dataclasses import replace

import pytest

from edge.geodesy import VehiclePosition, moved
from edge.journal.records import FixChecked, PlaceFix, Record, SourceSetAnswered
from edge.localization import Fix, ProtectionLevel
from edge.telemetry.acknowledgements import ANSWER_NS, FixTransmission, PositionUse
from edge.telemetry.firmware import SET_WITHOUT_GPS
from edge.telemetry.people import Publisher
from edge.telemetry.source_selection import SourceSelection
from edge.telemetry.vehicle import Vehicle
from tests.common import S


def sent(own: VehiclePosition, north_m: float, sigma_m: float = 2.0) -> FixTransmission:
    """A position so many meters north of the autopilot's."""
    lat_deg, lon_deg = moved(own.lat_deg, own.lon_deg, 0.0, north_m)
    fix = PlaceFix(
        stamp_ns=own.stamp_ns, place=0, heading_deg=0.0, sigma_along_m=sigma_m, sigma_cross_track_m=sigma_m,
        direction="forward", order="same", uniqueness=1.2, matches=9, segment=0, recording="drive",
        confidence=0.9, velocity_error=0.0, disputed=False, lat_deg=lat_deg, lon_deg=lon_deg,
    )  # fmt: skip
    return FixTransmission(Fix(fix, ProtectionLevel(9.0, 9.0)), own.stamp_ns, own)


BEFORE = VehiclePosition(10 * S, 0.0, 10.0, 20.0, 0.0, 10.0, north_mps=10.0)


@pytest.mark.parametrize(
    ("north_m", "remaining_m", "has_moved"),
    [(50.0, 0.0, True), (30.5, 19.5, True), (29.0, 21.0, False), (10.0, 40.0, False)],
)
def test_a_jump_is_the_move_that_driving_does_not_explain(north_m: float, remaining_m: float, has_moved: bool) -> None:
    fix = sent(BEFORE, 40.0)
    lat_deg, _ = moved(0.0, 10.0, 0.0, north_m)
    a_second_later = replace(BEFORE, stamp_ns=11 * S, lat_deg=lat_deg)
    assert fix.remaining_m(a_second_later) == pytest.approx(remaining_m, abs=0.05)
    assert fix.moved(fix.remaining_m(a_second_later)) is has_moved


def test_a_jump_within_the_fixs_own_deviation_has_always_happened() -> None:
    fix = sent(BEFORE, 4.0, sigma_m=5.0)
    lat_deg, _ = moved(0.0, 10.0, 0.0, 10.0)
    assert fix.moved(fix.remaining_m(replace(BEFORE, stamp_ns=11 * S, lat_deg=lat_deg)))


class Stream:
    """Positions of a stream, one a second, at given distances from the autopilot's own."""

    def __init__(self) -> None:
        self.records: list[Record] = []
        publisher = Publisher(self.records.append, lambda text: None)
        self.use = PositionUse(Vehicle(), publisher)

    def checked(self, distances_m: list[float], from_s: int = 100) -> list[tuple[int, bool]]:
        """After which second it was said whether the autopilot has come nearer."""
        said = []
        for second, far_m in enumerate(distances_m):
            own = replace(BEFORE, stamp_ns=(from_s + second) * S)
            self.use.expect(sent(own, far_m, sigma_m=1.414), is_reset=False)
            said += [(second, one.moved) for one in self.records if isinstance(one, FixChecked)]
            self.records.clear()
        return said


@pytest.mark.parametrize(("far_m", "later_m", "is_used"), [(25.0, 25.0, False), (25.0, 12.0, True), (5.0, 1.9, True)])
def test_an_autopilot_that_is_far_from_a_stream_must_come_nearer(far_m: float, later_m: float, is_used: bool) -> None:
    """One standard deviation is 2 m."""
    assert Stream().checked([far_m] * 5 + [later_m] * 10) == [(10, is_used)]


def test_one_that_drifts_away_from_a_stream_does_not_use_it() -> None:
    """It is near at first, which says nothing: the autopilot has just lost GPS."""
    assert Stream().checked([0.3 * second for second in range(60)]) == [(30, False)]


def test_one_that_stays_near_a_stream_says_nothing() -> None:
    assert Stream().checked([1.0, 3.0, 2.0] * 40) == []


def test_each_stream_is_checked_anew() -> None:
    stream = Stream()
    assert stream.checked([25.0] * 30) == [(10, False)]
    assert stream.checked([25.0] * 30, from_s=200) == [(10, False)]


def test_a_selection_of_sources_that_is_not_answered_for_a_second_is_recorded() -> None:
    records: list[Record] = []
    selection = SourceSelection(Vehicle(), Publisher(records.append, lambda text: None))
    selection.want(SET_WITHOUT_GPS, "faulty")
    assert len(selection.due(S)) == 1
    selection.due(S + ANSWER_NS - 1)
    assert records == []
    selection.due(S + ANSWER_NS)
    assert records == [SourceSetAnswered(SET_WITHOUT_GPS, "NO_ANSWER")]
