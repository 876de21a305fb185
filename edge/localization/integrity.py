"""Checks before a position is published to the autopilot, each with its reason; the autopilot has no such checks.

A wrong fix does more harm than none. So the vehicle must move and be on the map now, several matches must agree with
the distance driven, and the fix must be consistent with the autopilot's position: within its uncertainty at once,
farther away only after many more matches, and too far away never. If the autopilot's position may be anything, an
earlier fix of another place must confirm the fix (`fix_consistency`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias

from edge.config import GatesConfig
from edge.geodesy import VehiclePosition, east_north_of
from edge.journal.records import PlaceFix

GpsState: TypeAlias = Literal["healthy", "not healthy", "unknown"]
Reason: TypeAlias = Literal[
    "no position in the map",
    "too old",
    "GPS is healthy",
    "GPS is unknown",
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
    """What the checks use besides the fix, at the time `now_ns`.

    position: the autopilot's own, None if it has none. uncertainty_m: its standard deviation, None if unbounded.
    speed_mps: None if unknown. last_sent_ns: of the last fix, None if there was none.
    confirmed: whether an earlier fix elsewhere agrees with this one.
    """

    now_ns: int
    gps: GpsState
    speed_mps: float | None
    position: VehiclePosition | None
    uncertainty_m: float | None
    last_sent_ns: int | None
    confirmed: bool = False


@dataclass(frozen=True)
class Refusal:
    """Why a fix is withheld. distance_m: from the autopilot's own position, None if unknown."""

    reason: Reason
    distance_m: float | None = None


def refusal(
    fix: PlaceFix, situation: Situation, gates: GatesConfig, period_s: float, oldest_s: float
) -> Refusal | None:
    """The first check that the fix fails; None if it may be published."""
    age_s = (situation.now_ns - fix.stamp_ns) / 1e9
    since_s = math.inf if situation.last_sent_ns is None else (situation.now_ns - situation.last_sent_ns) / 1e9
    rules: tuple[tuple[bool, Reason], ...] = (
        (not fix.is_position, "no position in the map"),
        (not 0 <= age_s <= oldest_s, "too old"),
        (situation.gps == "healthy" and not gates.with_gps, "GPS is healthy"),
        (situation.gps == "unknown" and not gates.with_gps, "GPS is unknown"),
        (situation.speed_mps is not None and situation.speed_mps < gates.min_speed_mps, "standing"),
        (since_s < period_s, "too soon"),
        (fix.matches < gates.near_matches, "too few matches in a row"),
    )
    for against, reason in rules:
        if against:
            return Refusal(reason)
    return _too_far(fix, situation, gates)


def _too_far(fix: PlaceFix, situation: Situation, gates: GatesConfig) -> Refusal | None:
    """Check the distance from the autopilot's own position against the standard deviations of both."""
    distance_m = distance_from(situation.position, fix) if situation.position is not None else None
    if distance_m is None or situation.uncertainty_m is None:
        # The autopilot's position is unknown or unbounded: only other recognized places can confirm the fix.
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
    """Meters east and north from the autopilot's position at the fix's time to the fix.

    The autopilot's newest position is moved to that time by its velocity.
    """
    apart_s = (fix.stamp_ns - position.stamp_ns) / 1e9
    assert fix.lat_deg is not None and fix.lon_deg is not None
    east_m, north_m = east_north_of(fix.lat_deg, fix.lon_deg, (position.lat_deg, position.lon_deg))
    return east_m - position.east_mps * apart_s, north_m - position.north_mps * apart_s


def distance_from(position: VehiclePosition, fix: PlaceFix) -> float:
    """Length of `offset_m`."""
    return math.hypot(*offset_m(position, fix))


class Uncertainty:
    """Standard deviation of the autopilot's position: set by GPS or a fix, and growing with the distance driven."""

    def __init__(self, drift_percent: float) -> None:
        self._drift = drift_percent / 100
        self._bound: tuple[float, float] | None = None  # standard deviation, and meters driven at that time

    def bind(self, sigma_m: float, driven_m: float | None) -> None:
        """Set the standard deviation at a distance driven."""
        if driven_m is not None:
            self._bound = sigma_m, driven_m

    def reset(self) -> None:
        """The autopilot has rebooted: nothing bounds its position any more."""
        self._bound = None

    def at(self, driven_m: float | None, reported_m: float | None) -> float | None:
        """Standard deviation now: the larger of ours and the autopilot's own; None if unbounded."""
        if self._bound is None or driven_m is None:
            return reported_m
        sigma_m, since_m = self._bound
        ours_m = math.hypot(sigma_m, self._drift * max(0.0, driven_m - since_m))
        return ours_m if reported_m is None else max(ours_m, reported_m)
