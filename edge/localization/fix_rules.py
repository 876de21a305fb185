"""Why a position may not be published: every reason, in the order of the checks. docs/positions.md lists them.

A position passes only if none holds, and what is not known counts as against it. One may rest on those before it, so
none is asked after one that holds.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from msgspec import Struct

from edge.config import GatesConfig
from edge.journal.records import PlaceFix
from edge.localization.events import UNBOUNDED, AutopilotState, FixRequest, ProtectionLevel


@dataclass(frozen=True)
class GateInputs:
    """The inputs that the rules check; None: not known.

    autopilot, is_blurred: see `StateEstimate`. place: the position. age_s: since its moment. distance_m: from the
    autopilot's own. move_m: the same, 0 where that has no aiding: after a reboot without GPS it may be the mere
    origin. is_contradicted: whether they are further apart than both are uncertain. wrong: probability of another
    place, infinite where nothing was observed. level: how far off it may be. is_needed: of a reset, whether the
    autopilot is beyond doubt elsewhere.
    """

    gates: GatesConfig
    request: FixRequest
    autopilot: AutopilotState
    is_blurred: bool
    place: PlaceFix | None = None
    age_s: float = math.inf
    distance_m: float | None = None
    move_m: float = 0.0
    is_contradicted: bool = False
    wrong: float = math.inf
    level: ProtectionLevel = UNBOUNDED
    is_needed: bool = True


class Rule(NamedTuple):
    """A reason as the journal and the pilot have it; when it holds; the test that fails without it; its predicate.

    detail: what else is said of it. is_certain: whether the place is certain enough by then. lacks: for people, what is
    missing, in figures that change with every frame.
    """

    reason: str
    when: str
    test: str
    holds: Callable[[GateInputs], bool]
    detail: Callable[[GateInputs], str] = lambda facts: ""
    is_certain: bool = False
    lacks: Callable[[GateInputs], str] = lambda facts: ""


GPS_HEALTHY = "GPS is healthy"
NOT_NEEDED = "no reset is needed"
NO_PLACES = "the places do not agree yet"
STANDING = "standing"
TWO_AUTOPILOTS = "two autopilots have the same ids"
RULES = (
    Rule(
        TWO_AUTOPILOTS,
        "messages with its ids have timestamps of another clock",
        "test_two_autopilots_with_the_same_ids_get_no_position",
        lambda now: now.autopilot.is_doubled,
    ),
    Rule(
        "the autopilot's clock is not known",
        # After one position with the stamp of the old clock, the next hundred would count as half a second old.
        "it sent nothing for 0.3 s, or its newest stamp is of another clock: it may have rebooted",
        "test_nothing_is_sent_to_an_autopilot_whose_clock_is_not_known",
        lambda now: now.request.moves_autopilot and not now.autopilot.is_clock_known,
    ),
    Rule(
        "nothing is recognized now",
        "the pictures are dark, frozen or of an unknown time, or the vehicle is off the map",
        "test_situations_in_which_nothing_is_published",
        lambda now: bool(now.request.unable),
        lambda now: now.request.unable,
    ),
    Rule(
        "recognized, but not exactly",
        "no sequence match locates the vehicle to a few meters: its cost minimum is too flat (sharpness below 5 %), "
        "another place fits the newest frame better, or its road leads off the vehicle's course",
        "test_a_line_that_is_not_sharp_is_not_used",
        lambda now: now.place is None and now.is_blurred,
    ),
    Rule(
        NO_PLACES,
        "no place was recognized lately, or the vehicle has left it",
        "test_situations_in_which_nothing_is_published",
        lambda now: now.place is None,
    ),
    Rule(
        "too old",
        "its exposure is older than the message allows, or lies ahead",
        "test_situations_in_which_nothing_is_published",
        lambda now: not 0 <= now.age_s <= now.request.oldest_s,
    ),
    Rule(
        GPS_HEALTHY,
        "GPS works, and `with_gps` is not set",
        "test_situations_in_which_nothing_is_published",
        lambda now: now.autopilot.gps == "healthy" and now.request.moves_autopilot and not now.gates.with_gps,
    ),
    Rule(
        "GPS is unknown",
        "a receiver is silent or unsteady, or the filter does not use it",
        "test_situations_in_which_nothing_is_published",
        lambda now: now.autopilot.gps == "unknown" and now.request.moves_autopilot and not now.gates.with_gps,
        lambda now: now.autopilot.gps_why,
    ),
    Rule(
        "the speed is not known",
        "no speed has come for a second",
        "test_situations_in_which_nothing_is_published",
        lambda now: now.autopilot.speed_mps is None or not math.isfinite(now.autopilot.speed_mps),
    ),
    Rule(
        STANDING,  # One error would be sent again and again, and the filter believe it more each time.
        "slower than `min_speed_mps`",
        "test_situations_in_which_nothing_is_published",
        lambda now: (now.autopilot.speed_mps or 0.0) < now.gates.min_speed_mps,
    ),
    Rule(
        "the innovation test fails",
        "matches or dead reckoning contradict the estimate",
        "test_situations_in_which_nothing_is_published",
        lambda now: now.place is not None and now.place.disputed,
    ),
    Rule(
        "impossibly far",
        "over `max_move_m` from the autopilot's own position, if GPS or a fix has aided that since boot",
        "test_situations_in_which_nothing_is_published",
        lambda now: now.move_m > now.gates.max_move_m,
        lacks=lambda now: f"{now.move_m:.0f} m",
    ),
    Rule(
        "not confirmed by another place yet",
        "no independent segment confirms it: the probability of a wrong match is above `risk`",
        "test_two_segments_of_one_recording_do_not_confirm_each_other",
        lambda now: math.isinf(now.wrong) or now.wrong > now.gates.risk,
        lacks=lambda now: f"{now.distance_m:.0f} m from the autopilot" if now.is_contradicted else "",
    ),
    Rule(
        "its protection level is above the alert limit",
        "`alert_limit_m` is set, and the level along-track or cross-track is above it",
        "test_a_position_above_the_alert_limit_is_not_published",
        lambda now: not now.level.is_within(now.gates.alert_limit_m or math.inf),
        is_certain=True,
    ),
    Rule(
        NOT_NEEDED,
        "a reset, of an autopilot that is nearer than `min_move_m`, or than three standard deviations of the position, "
        "along-track and cross-track",
        "test_an_autopilot_is_reset_where_it_is_beyond_doubt_off",
        lambda now: not now.is_needed,
        is_certain=True,
        lacks=lambda now: f"{now.distance_m or 0.0:.1f} m apart",
    ),
)
"""In the order in which they are checked."""


class NoFix(Struct, frozen=True, tag="Refusal"):
    """Why a position is withheld.

    detail: what else is known of the reason. lacks: see `Rule`. fix: the position, None where there is none.
    distance_m: from the autopilot's own position. level: see `Fix`, where the place is certain enough. None: not known.
    """

    reason: str
    detail: str = ""
    fix: PlaceFix | None = None
    distance_m: float | None = None
    level: ProtectionLevel | None = None
    lacks: str = ""

    @property
    def in_words(self) -> str:
        """For people."""
        return f"{self}, {self.lacks}" if self.lacks else str(self)

    def __str__(self) -> str:
        return f"{self.reason}: {self.detail}" if self.detail else self.reason


def refusal(facts: GateInputs, rules: Sequence[Rule]) -> NoFix | None:
    """The first reason that holds, None where a position may be published."""
    rule = next((one for one in rules if one.holds(facts)), None)
    if rule is None:
        return None
    level = facts.level if rule.is_certain else None
    return NoFix(rule.reason, rule.detail(facts), facts.place, facts.distance_m, level, rule.lacks(facts))
