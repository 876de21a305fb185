"""When a position may go to the autopilot: pure rules, each with its reason. The autopilot has none of them.

A wrong fix does more harm than none, so a fix must come from a vehicle that moves and is on the map now, agree with
the distance driven for several matches, and lie where the autopilot may be: within its uncertainty at once, further
off only after many more matches, and beyond all reason never. Where the autopilot may be anywhere, an earlier fix from
another place must confirm it (`witnesses`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias

from edge.config import GatesConfig
from edge.geodesy import VehiclePosition, east_north_of
from edge.journal.records import PlaceFix

Reason: TypeAlias = Literal[
    "no position in the map",
    "too old",
    "GPS is healthy",
    "standing",
    "too soon",
    "too few matches in a row",
    "too few matches for a far fix",
    "not confirmed by another place yet",
    "impossibly far",
]
GPS_SIGMA_M = 3.0


@dataclass(frozen=True)
class Situation:
    """What the gates look at besides the fix, at the moment `now_ns`.

    position: the autopilot's own, None where it has none. uncertainty_m: one standard deviation of it, None where
    nothing has ever bound it. speed_mps: None where nobody tells. last_sent_ns: of the last fix, None for none yet.
    confirmed: whether an earlier fix elsewhere agrees with this one.
    """

    now_ns: int
    gps_healthy: bool
    speed_mps: float | None
    position: VehiclePosition | None
    uncertainty_m: float | None
    last_sent_ns: int | None
    confirmed: bool = False


@dataclass(frozen=True)
class Refusal:
    """Why a fix stays here. distance_m: from the autopilot's own position, where that was known."""

    reason: Reason
    distance_m: float | None = None


def refusal(
    fix: PlaceFix, situation: Situation, gates: GatesConfig, period_s: float, oldest_s: float
) -> Refusal | None:
    """None when the fix may go, else the first rule against it."""
    age_s = (situation.now_ns - fix.stamp_ns) / 1e9
    since_s = math.inf if situation.last_sent_ns is None else (situation.now_ns - situation.last_sent_ns) / 1e9
    rules: tuple[tuple[bool, Reason], ...] = (
        (fix.lat_deg is None, "no position in the map"),
        (not 0 <= age_s <= oldest_s, "too old"),
        (situation.gps_healthy and not gates.with_gps, "GPS is healthy"),
        (situation.speed_mps is not None and situation.speed_mps < gates.min_speed_mps, "standing"),
        (since_s < period_s, "too soon"),
        (fix.matches < gates.near_matches, "too few matches in a row"),
    )
    for against, reason in rules:
        if against:
            return Refusal(reason)
    return _too_far(fix, situation, gates)


def _too_far(fix: PlaceFix, situation: Situation, gates: GatesConfig) -> Refusal | None:
    """The distance from the autopilot's own position, in units of what both may be wrong by."""
    distance_m = distance_from(situation.position, fix) if situation.position is not None else None
    if distance_m is None or situation.uncertainty_m is None:
        # Nothing is known of where the vehicle may be: only what it recognises can tell.
        if fix.matches < gates.far_matches:
            return Refusal("too few matches for a far fix", distance_m)
        return None if situation.confirmed else Refusal("not confirmed by another place yet", distance_m)
    sigmas = distance_m / math.hypot(situation.uncertainty_m, fix.sigma_m)
    if sigmas > gates.far_sigmas:
        return Refusal("impossibly far", distance_m)
    if sigmas > gates.near_sigmas and fix.matches < gates.far_matches:
        return Refusal("too few matches for a far fix", distance_m)
    return None


def offset_m(position: VehiclePosition, fix: PlaceFix) -> tuple[float, float]:
    """Metres east and north from where the autopilot believed to be at the fix's moment to the fix.

    Its newest position is moved to that moment by its own velocity.
    """
    apart_s = (fix.stamp_ns - position.stamp_ns) / 1e9
    assert fix.lat_deg is not None and fix.lon_deg is not None
    east_m, north_m = east_north_of(fix.lat_deg, fix.lon_deg, (position.lat_deg, position.lon_deg))
    return east_m - position.east_mps * apart_s, north_m - position.north_mps * apart_s


def distance_from(position: VehiclePosition, fix: PlaceFix) -> float:
    """Length of `offset_m`."""
    return math.hypot(*offset_m(position, fix))


class Uncertainty:
    """How wrong the autopilot's own position may be: bound by GPS or a fix, and growing with the distance since."""

    def __init__(self, drift_percent: float) -> None:
        self._drift = drift_percent / 100
        self._bound: tuple[float, float] | None = None  # one standard deviation, and metres driven when it held

    def bind(self, sigma_m: float, driven_m: float | None) -> None:
        """The position is known to `sigma_m`, at that reading of the odometer."""
        if driven_m is not None:
            self._bound = sigma_m, driven_m

    def reset(self) -> None:
        """The autopilot has rebooted: nothing bounds its position any more."""
        self._bound = None

    def at(self, driven_m: float | None, reported_m: float | None) -> float | None:
        """One standard deviation now: the larger of ours and the autopilot's own, None where nothing is known."""
        if self._bound is None or driven_m is None:
            return reported_m
        sigma_m, since_m = self._bound
        ours_m = math.hypot(sigma_m, self._drift * max(0.0, driven_m - since_m))
        return ours_m if reported_m is None else max(ours_m, reported_m)
