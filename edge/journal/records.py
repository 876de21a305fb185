"""What the journal says of positions for the autopilot: the way, what was held back, sent, answered and checked.

place: row of the map. map: its name, where there is a folder of them.
"""

from __future__ import annotations

import msgspec
from msgspec import UNSET, UnsetType


class WayChosen(msgspec.Struct, frozen=True, tag_field="event", tag="way"):
    """How positions will be told from now on; `report` is no position at all."""

    way: str
    why: str


class FixWithheld(msgspec.Struct, frozen=True, tag_field="event", tag="fix_withheld"):
    """A gate held a position back, for the first time since the last one went or another gate held."""

    place: int
    reason: str
    distance_m: float | None = None
    map: str | UnsetType = UNSET


class FixSent(msgspec.Struct, frozen=True, tag_field="event", tag="fix_sent"):
    """A position has left for the autopilot; of a steady stream one a second is recorded.

    distance_m: from the autopilot's own position of that moment. again: no answer came to the first try.
    """

    place: int
    way: str
    lat_deg: float
    lon_deg: float
    sigma_m: float
    send_boot_s: float
    age_s: float
    distance_m: float | None
    again: bool = False
    map: str | UnsetType = UNSET


class FixAnswered(msgspec.Struct, frozen=True, tag_field="event", tag="fix_answered"):
    """The autopilot's answer to a position, MAV_RESULT's name without its prefix, or "NO_ANSWER"."""

    place: int
    result: str
    map: str | UnsetType = UNSET


class FixChecked(msgspec.Struct, frozen=True, tag_field="event", tag="fix_checked"):
    """Whether the autopilot's own position moved after it had accepted; remaining_m from where the fix says."""

    place: int
    moved: bool
    remaining_m: float
    map: str | UnsetType = UNSET
