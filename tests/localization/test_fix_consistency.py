"""The first fix of a vehicle that may be anywhere: confirmed by another place, and never by itself."""

from __future__ import annotations

import msgspec
import pytest

from edge.config import GatesConfig
from edge.localization import PlaceFix
from edge.localization.dead_reckoning import Displacement
from edge.localization.fix_consistency import FixConsistency

METRE_DEG = 1 / 110_574  # of latitude, at the equator
GATES = GatesConfig()
FIX = PlaceFix(0, 7, 0.0, 10.0, 0.0, 3.0, 2.0, "forward", "same", 1.3, "street", matches=20)


def confirms(
    witnesses: FixConsistency,
    north_m: float,
    reckoned_m: float,
    *,
    leg: int = 1,
    matches: int = 20,
    driven: bool = True,
) -> bool:
    """A fix so far north of the start, where the vehicle reckons to be `reckoned_m` north of it."""
    fix = msgspec.structs.replace(FIX, lat_deg=north_m * METRE_DEG, matches=matches)
    return witnesses.confirm(fix, Displacement(leg, 0.0, reckoned_m), reckoned_m if driven else None)


def test_a_place_never_confirms_itself() -> None:
    witnesses = FixConsistency(GATES)
    assert not any(confirms(witnesses, at_m, at_m) for at_m in range(0, 100, 10))


@pytest.mark.parametrize(
    ("off_m", "confirmed"),
    [(0.0, True), (40.0, True), (-40.0, True), (48.0, False), (300.0, False)],
)
def test_another_place_does_if_the_way_between_is_right(off_m: float, confirmed: bool) -> None:
    """Three deviations of two fixes of 3 m each, and of 5 % of 300 m."""
    witnesses = FixConsistency(GATES)
    confirms(witnesses, 0.0, 0.0)
    assert confirms(witnesses, 300.0 + off_m, 300.0) == confirmed


def test_a_false_place_is_outvoted_by_two_true_ones() -> None:
    witnesses = FixConsistency(GATES)
    assert not confirms(witnesses, 300.0, 0.0), "claims to be 300 m from where it is"
    assert not confirms(witnesses, 200.0, 200.0)
    assert confirms(witnesses, 400.0, 400.0)


@pytest.mark.parametrize("other", [{"leg": 2}, {"matches": 11}, {"driven": False}])
def test_what_cannot_be_compared_confirms_nothing(other: dict[str, int | bool]) -> None:
    witnesses = FixConsistency(GATES)
    confirms(witnesses, 0.0, 0.0)
    assert not confirms(witnesses, 300.0, 300.0, **other)  # type: ignore[arg-type]  # by name


def test_reckoning_that_is_too_long_confirms_nothing() -> None:
    witnesses = FixConsistency(GATES)
    confirms(witnesses, 0.0, 0.0)
    assert not confirms(witnesses, 1100.0, 1100.0)


def test_it_forgets_and_can_be_switched_off() -> None:
    witnesses = FixConsistency(GATES)
    confirms(witnesses, 0.0, 0.0)
    witnesses.reset()
    assert not confirms(witnesses, 300.0, 300.0)
    assert confirms(FixConsistency(GatesConfig(confirm_m=0.0)), 300.0, 300.0)
