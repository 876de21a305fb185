"""Why a position may not be published: every reason, in the order of the checks. docs/positions.md shows the table.

A position passes only if none holds, and what is not known counts as against it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple, TypeAlias

Reason: TypeAlias = Literal[
    "no position in the map",
    "too old",
    "GPS is healthy",
    "GPS is unknown",
    "the speed is not known",
    "standing",
    "too soon",
    "the newest matches disagree",
    "the displacement is not known",
    "impossibly far",
    "not confirmed by another place yet",
    "its protection level is above the alert limit",
    "less accurate than the autopilot",
]


class Rule(NamedTuple):
    """A reason as the journal has it; when it holds; what would happen without it; the test that fails without it."""

    reason: Reason
    when: str
    hazard: str
    test: str


RULES = (
    Rule(
        "no position in the map",
        "the map has no position at this place, or one that is not finite",
        "the vehicle is sent anywhere",
        "test_fixes_that_are_not_published",
    ),
    Rule(
        "too old",
        "its exposure is older than the message allows, or lies ahead",
        "the vehicle is moved to where it was",
        "test_situations_in_which_nothing_is_published",
    ),
    Rule(
        "GPS is healthy",
        "GPS works, and `with_gps` is not set",
        "a better position is made worse",
        "test_situations_in_which_nothing_is_published",
    ),
    Rule(
        "GPS is unknown",
        "a receiver is silent or unsteady, or the filter does not use it",
        "two positions compete in the filter",
        "test_situations_in_which_nothing_is_published",
    ),
    Rule(
        "the speed is not known",
        "no speed has come for a second",
        "nobody knows how old the picture's place is in meters",
        "test_situations_in_which_nothing_is_published",
    ),
    Rule(
        "standing",
        "slower than `min_speed_mps`",
        "one error is sent again and again, and the filter believes it more each time",
        "test_situations_in_which_nothing_is_published",
    ),
    Rule(
        "too soon",
        "the last one was less than the message's period ago",
        "errors that are alike count as many",
        "test_situations_in_which_nothing_is_published",
    ),
    Rule(
        "the newest matches disagree",
        "matches or reckoning contradict the estimate",
        "the vehicle follows one of two places",
        "test_fixes_that_are_not_published",
    ),
    Rule(
        "the displacement is not known",
        "the autopilot reports no velocity",
        "nothing says whether places move as the vehicle does",
        "test_situations_in_which_nothing_is_published",
    ),
    Rule(
        "impossibly far",
        "over `max_move_m` from where GPS or a position bounded the autopilot",
        "a single error carries the vehicle away",
        "test_fixes_that_are_not_published",
    ),
    Rule(
        "not confirmed by another place yet",
        "the probability of another place is above `risk`",
        "a wrong map, or a road that resembles it, moves the vehicle",
        "test_two_segments_of_one_recording_do_not_confirm_each_other",
    ),
    Rule(
        "its protection level is above the alert limit",
        "`alert_limit_m` is set, and the level along or across is above it",
        "the vehicle goes on where it may be further off than it can tolerate",
        "test_a_position_above_the_alert_limit_is_not_published",
    ),
    Rule(
        "less accurate than the autopilot",
        "a reset that is less certain than the autopilot by over a fifth; one of over 10 m, unless twice as certain; "
        "any of over 10 m where nothing measures the velocity",
        "a good position is replaced by a worse one",
        "test_a_reset_never_makes_a_position_less_accurate",
    ),
)


@dataclass(frozen=True)
class Refusal:
    """Why a fix is withheld. distance_m: from the autopilot's own position, None if unknown."""

    reason: Reason
    distance_m: float | None = None


def as_table() -> str:
    """The rules for people, as a table in Markdown."""
    rows = (f"| {one.reason} | {one.when} | {one.hazard} |" for one in RULES)
    return "\n".join(["| reason | when | what it prevents |", "|---|---|---|", *rows])
