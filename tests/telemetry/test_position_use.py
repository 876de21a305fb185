"""What is concluded from an autopilot that is near its positions, and from one that does not answer."""

from __future__ import annotations

import pytest

from edge.journal.records import FixChecked, PlaceFix, Record, SourceSetAnswered
from edge.localization import Fix, ProtectionLevel
from edge.telemetry.acknowledgements import ANSWER_NS, FixTransmission, PositionUse
from edge.telemetry.firmware import SET_WITHOUT_GPS
from edge.telemetry.people import Publisher
from edge.telemetry.source_selection import SourceSelection
from edge.telemetry.vehicle import Vehicle
from tests.common import S


def sent(at_s: int, far_m: float, sigma_m: float = 1.414) -> FixTransmission:
    """A position so many meters from the autopilot's."""
    fix = PlaceFix(
        stamp_ns=at_s * S, place=0, heading_deg=0.0, sigma_along_m=sigma_m, sigma_cross_track_m=sigma_m,
        direction="forward", order="same", uniqueness=1.2, matches=9, segment=0, recording="drive",
        confidence=0.9, velocity_error=0.0, disputed=False, lat_deg=0.0, lon_deg=10.0,
    )  # fmt: skip
    return FixTransmission(Fix(fix, ProtectionLevel(9.0, 9.0)), at_s * S, far_m)


class Stream:
    """Positions of a stream, one a second, at given distances from the autopilot's own."""

    def __init__(self) -> None:
        self.records: list[Record] = []
        publisher = Publisher(self.records.append, lambda text: None)
        self.use = PositionUse(publisher)

    def checked(self, distances_m: list[float], from_s: int = 100, *, is_reset: bool = False) -> list[tuple[int, bool]]:
        """After which second it was said whether the autopilot has come nearer."""
        said = []
        for second, far_m in enumerate(distances_m):
            self.use.expect(sent(from_s + second, far_m), is_reset=is_reset)
            said += [(second, one.moved) for one in self.records if isinstance(one, FixChecked)]
            self.records.clear()
        return said


@pytest.mark.parametrize(("far_m", "later_m", "is_used"), [(25.0, 25.0, False), (25.0, 12.0, True), (5.0, 1.9, True)])
def test_an_autopilot_that_is_far_from_a_stream_must_come_nearer(far_m: float, later_m: float, is_used: bool) -> None:
    """One standard deviation is 2 m."""
    assert Stream().checked([far_m] * 5 + [later_m] * 10) == [(10, is_used)]


@pytest.mark.parametrize(("later_m", "is_used"), [(25.0, False), (3.0, True)])
def test_resets_have_moved_it_after_3_s(later_m: float, is_used: bool) -> None:
    assert Stream().checked([25.0] + [later_m] * 20, is_reset=True) == [(3, is_used)]


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
