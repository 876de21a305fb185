"""What is joined in the localizer: GPS is compared with a place only where the vehicle heads along its road."""

from __future__ import annotations

import pytest

from edge.config import RigConfig
from edge.localization import GpsFix
from edge.localization.localizer import Localizer
from edge.reference_map import MapSet
from tests.localization.straight_road import LAT_DEG, METRE_DEG, SPACING_M, match, settings

TURNED_AT, FRAMES = 110, 40


@pytest.mark.parametrize(("heading_deg", "is_called"), [(0.0, False), (None, True)])
def test_a_match_that_turns_where_the_vehicle_goes_on_says_nothing_of_gps(
    map_set: MapSet, heading_deg: float | None, is_called: bool
) -> None:
    """A drive that turned round is in the map; matches follow it back for a while, and GPS goes on with the vehicle.

    Without a heading, an honest GPS is called wrong.
    """
    localizer = Localizer(map_set, settings(RigConfig()))

    def judged(place: int, direction: str, seen: int) -> str:
        gps = GpsFix(LAT_DEG + place * SPACING_M * METRE_DEG, 153.0, 1.0)
        return localizer.judge_gps(match(seen, direction), gps, None, heading_deg).state

    states = [judged(place, "forward", place) for place in range(30, TURNED_AT)]
    assert states[-1] == "agrees"
    turned = [judged(TURNED_AT + far, "reverse", TURNED_AT - far) for far in range(FRAMES)]
    assert ("wrong" in turned) == is_called
