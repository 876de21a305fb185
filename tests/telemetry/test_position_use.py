"""What is concluded from an autopilot that is near its positions, and from one that does not answer."""

from __future__ import annotations

import pytest

from edge.geodesy import moved
from edge.journal.records import PlaceFix, Record, SourceSetAnswered
from edge.telemetry.acknowledgements import ANSWER_NS
from edge.telemetry.link_protocol import Publisher
from edge.telemetry.position_messages import POSITION_MESSAGES
from edge.telemetry.position_use import PositionUse
from edge.telemetry.source_selection import VISION_SET, SourceSelection
from edge.telemetry.vehicle import Vehicle
from tests.telemetry.speaker import S, Speaker, connect


@pytest.mark.parametrize(("north_m", "follows"), [(8.0, True), (14.0, False)])
def test_within_three_sigma_an_autopilot_follows_a_stream(north_m: float, follows: bool) -> None:
    """One standard deviation is 2.8 m. Beyond three, the next position counts as a jump."""
    speaker = Speaker()
    vehicle = connect(speaker)
    vehicle.handle(speaker.fix(2000, 0.0, vn_mps=10.0, ve_mps=0.0), 2 * S)
    own = vehicle.position(2 * S)
    assert own is not None
    lat_deg, lon_deg = moved(own.lat_deg, own.lon_deg, 0.0, north_m)
    fix = PlaceFix(
        stamp_ns=2 * S, place=0, heading_deg=0.0, sigma_along_m=2.0, sigma_across_m=2.0, direction="forward",
        order="same", uniqueness=1.2, category="", matches=9, segment=0, recording="drive", confidence=0.9,
        velocity_error=0.0, disputed=False, lat_deg=lat_deg, lon_deg=lon_deg,
    )  # fmt: skip
    bound: list[float] = []
    use = PositionUse(
        vehicle, lambda sigma_m, now_ns: bound.append(sigma_m), 1, Publisher(lambda record: None, lambda text: None)
    )
    use.expect(fix, POSITION_MESSAGES["vision_position"], 2 * S, again=False, is_new_stream=True)
    assert (bound == [pytest.approx(north_m, abs=0.1)]) is follows
    assert use.reset_counter == (0 if follows else 1)


def test_a_selection_of_sources_that_is_not_answered_for_a_second_is_recorded() -> None:
    records: list[Record] = []
    selection = SourceSelection(Vehicle(), Publisher(records.append, lambda text: None))
    selection.wanted = VISION_SET
    assert len(selection.due(S)) == 1
    selection.due(S + ANSWER_NS)
    assert records == []
    selection.due(S + ANSWER_NS + 1)
    assert records == [SourceSetAnswered(VISION_SET, "NO_ANSWER")]
