"""What bounds the autopilot's own position, and where the vehicle is by that alone. Pure."""

from __future__ import annotations

import contextlib
import logging
import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import msgspec

from edge.geodesy import VehiclePosition, east_north_of, moved
from edge.journal.records import PlaceFix
from edge.localization.dead_reckoning import Displacement
from edge.localization.events import BOUND_WRONG, Fix, Own
from edge.sequence import Reckoning

PERIOD_NS = 1_000_000_000  # between two that are kept
SETTLED_NS = 10_000_000_000
"""After GPS is used again, nothing is left of a position of ours."""
LONGEST_NS = 600_000_000_000  # without a word of the autopilot, after which it may be another one
SAME_BOOT_NS = 2_000_000_000  # by which two times of one boot differ by delays of the link
CLOCK_RATE = 0.01  # the clock of a simulated autopilot was seen to run 0.75 % slow
FASTER = 1.5  # than the speeds before and after: what may have been driven in between
log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Bound:
    """GPS or a position of ours bounded the autopilot's: to one standard deviation, after so many meters driven.

    wrong: probability that it was wrong. by_gps: whether GPS did. axes: in each of two directions by itself.
    """

    sigma_m: float
    driven_m: float
    wrong: float
    by_gps: bool
    axes: Axes


class Axes(NamedTuple):
    """Of a position, along a heading and across it: one standard deviation each, after so many meters driven.

    What a position of ours left as it was goes on from before: its error grows with the distance, not with its root.
    """

    heading_deg: float
    sigmas_m: tuple[float, float]
    driven_m: tuple[float, float]

    def at(self, heading_deg: float, driven_m: float, drift: float) -> tuple[float, float]:
        """Standard deviations along another heading and across it, after so many meters."""
        along_m, across_m = (
            math.hypot(sigma_m, drift * max(0.0, driven_m - before_m))
            for sigma_m, before_m in zip(self.sigmas_m, self.driven_m, strict=True)
        )
        turned_rad = math.radians(heading_deg - self.heading_deg)
        cos, sin = math.cos(turned_rad), math.sin(turned_rad)
        return math.hypot(cos * along_m, sin * across_m), math.hypot(sin * along_m, cos * across_m)

    def bound_by(self, fix: Fix, driven_m: float, drift: float) -> Axes:
        """After the autopilot has used a position of ours."""
        place, before = fix.place, self.sigmas_m
        assert place.heading_deg is not None
        sigmas_m, driven = [place.sigma_along_m, place.sigma_across_m], [driven_m, driven_m]
        for axis, now_m in enumerate(self.at(place.heading_deg, driven_m, drift)):
            if fix.keeps[axis]:
                sigmas_m[axis] = min(*before, now_m)
                grown_m = math.sqrt(now_m**2 - sigmas_m[axis] ** 2)
                driven[axis] = driven_m - grown_m / drift if drift else driven_m
        return Axes(place.heading_deg, (sigmas_m[0], sigmas_m[1]), (driven[0], driven[1]))


@dataclass(frozen=True)
class Reckoned:
    """Where the vehicle is by an anchor: meters east and north of a fix, and one standard deviation."""

    east_m: float
    north_m: float
    sigma_m: float

    @property
    def distance_m(self) -> float:
        """From the fix."""
        return math.hypot(self.east_m, self.north_m)

    def position(self, fix: PlaceFix) -> VehiclePosition:
        """At the moment of the fix that it is relative to; standing, since it is of that moment alone."""
        assert fix.lat_deg is not None and fix.lon_deg is not None
        lat_deg, lon_deg = moved(fix.lat_deg, fix.lon_deg, self.east_m, self.north_m)
        return VehiclePosition(fix.stamp_ns, lat_deg, lon_deg, 0.0, None, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Anchor:
    """Where the vehicle was, by GPS or by an observation, to one standard deviation, at a displacement."""

    lat_deg: float
    lon_deg: float
    sigma_m: float
    displacement: Displacement

    def reckoned(self, fix: PlaceFix, now: Displacement, drift: float, driven_m: float | None = None) -> Reckoned:
        """Relative to a fix with a position, at a displacement; drift: of the meters driven, those in between if None.

        What may have been driven while the velocity was unknown is in the standard deviation.
        """
        assert fix.lat_deg is not None and fix.lon_deg is not None
        east_m, north_m = east_north_of(self.lat_deg, self.lon_deg, (fix.lat_deg, fix.lon_deg))
        moved_east_m, moved_north_m = now.since(self.displacement)
        if driven_m is None:
            driven_m = math.hypot(moved_east_m, moved_north_m)
        unknown_m = now.unknown_sigma_since(self.displacement)
        sigma_m = math.hypot(self.sigma_m, drift * driven_m, unknown_m)
        return Reckoned(east_m + moved_east_m, north_m + moved_north_m, sigma_m)


class Kept(msgspec.Struct, frozen=True):
    """What bounded an autopilot's position at `stamp_ns` of CLOCK_MONOTONIC; see `OwnPosition.snapshot`.

    by_fixes: whether it rests on positions of ours, or may.
    """

    system_id: int
    booted_ns: int
    stamp_ns: int
    sigma_m: float
    speed_mps: float
    lat_deg: float
    lon_deg: float
    by_fixes: bool = True

    def since(self, now: Kept, drift: float) -> float | None:
        """One standard deviation now, as far as the vehicle can have gone unheard: as fast as before or now.

        None where it is not certain that both are of one boot of one autopilot, or it was too long ago.
        """
        gap_ns = now.stamp_ns - self.stamp_ns
        if self.system_id != now.system_id or not 0 <= gap_ns <= LONGEST_NS:
            return None
        apart_ns = abs(now.booted_ns - self.booted_ns)
        if apart_ns > SAME_BOOT_NS + CLOCK_RATE * gap_ns or now.booted_ns >= self.stamp_ns:
            return None
        moved_m = math.hypot(*east_north_of(now.lat_deg, now.lon_deg, (self.lat_deg, self.lon_deg)))
        driven_m = max(FASTER * max(self.speed_mps, now.speed_mps) * gap_ns / 1e9, moved_m)
        log.info(
            "the autopilot has not rebooted: %.1f s ago its position was known to %.1f m", gap_ns / 1e9, self.sigma_m
        )
        return math.hypot(self.sigma_m, drift * driven_m)


class OwnPosition:
    """How far the autopilot's own position may be off, and where GPS had the vehicle last.

    What bounded the position (GPS or a fix) still does over a silent link and over a restart of this program, while the
    autopilot has not rebooted, which its boot time shows.
    """

    def __init__(self, drift: float) -> None:
        """drift: of the meters driven, where nothing else is known of the velocity."""
        self._drift = drift
        self.bound: Bound | None = None
        """What bounded it since its boot, None where nothing did."""
        self._has_run_away = False  # since then: nothing measured its velocity for a while
        self.by_gps: Anchor | None = None
        """Where GPS had the vehicle last."""
        self.when_lost: Anchor | None = None
        """The same, by motion in which GPS has no part."""
        self._by_gps_m = 0.0  # driven by then
        self._trusted: tuple[Anchor, float] | None = None  # of it, what no place can have moved, and driven by then
        self.rests_on_fixes = False
        """Whether a position that was sent may have moved the autopilot's own since GPS bounded it last."""
        self._sent_ns: int | None = None
        self._kept: Kept | None = None
        self._due_ns = 0

    def restart(self) -> None:
        """The autopilot has rebooted. What GPS showed of the vehicle holds on, see `Displacement.unknown_m`."""
        self.bound, self._sent_ns = None, None

    def sent(self, t_ns: int) -> None:
        """A position was sent: nobody knows yet whether the autopilot uses it."""
        self._sent_ns, self.rests_on_fixes = t_ns, True

    def bind(self, sigma_m: float, own: Own, wrong: float = BOUND_WRONG, *, by_gps: bool = False) -> None:
        """It is as good as that now, in each direction. wrong: the probability that what bounds it is."""
        if own.driven_m is not None:
            axes = Axes(0.0, (sigma_m, sigma_m), (own.driven_m, own.driven_m))
            self.bound, self._has_run_away = Bound(sigma_m, own.driven_m, wrong, by_gps, axes), False

    def bind_by_fix(self, fix: Fix, left_m: float, own: Own) -> None:
        """It has used a position, and is so far from it now."""
        before, place = self.bound, fix.place
        self.bind(max(place.sigma_m, left_m), own, fix.bound_wrong)
        if own.driven_m is None or left_m > place.sigma_m or place.heading_deg is None:
            return
        assert self.bound is not None
        axes = (before or self.bound).axes.bound_by(fix, own.driven_m, max(self._drift, place.velocity_error))
        self.bound = replace(self.bound, axes=axes)

    def watch_aid(self, own: Own) -> None:
        """One whose velocity nothing measures runs away, until it is bound anew."""
        self._has_run_away |= not own.is_aided

    def keep(self, t_ns: int, own: Own, *, is_by_gps: bool) -> float | None:
        """Keep what bounds it, once a second; what was kept where nothing does, as far as that still holds.

        is_by_gps: whether GPS bounds it now.
        """
        if is_by_gps and (self._sent_ns is None or t_ns - self._sent_ns > SETTLED_NS):
            self.rests_on_fixes = False
        if own.runs_away:
            self._kept = None
        if t_ns < self._due_ns or not own.is_aided:
            return None
        self._due_ns = t_ns + PERIOD_NS
        sigma_m, position, before = self.sigma_m(own), own.position, self._kept
        if position is None or own.speed_mps is None or own.system_id is None or own.booted_ns is None:
            return None
        where = own.speed_mps, position.lat_deg, position.lon_deg, self.rests_on_fixes
        now = Kept(own.system_id, own.booted_ns, t_ns, sigma_m or 0.0, *where)
        if sigma_m is not None:
            self._kept = now
            return None
        since_m = None if before is None else before.since(now, self._drift)
        if before is not None and since_m is not None:
            self.rests_on_fixes |= before.by_fixes
        return since_m

    def snapshot(self) -> bytes:
        """What is kept, b"" for nothing."""
        return b"" if self._kept is None else msgspec.json.encode(self._kept)

    def restore(self, kept: bytes) -> None:
        """Bind by what was kept, once the autopilot is known to be the same, and not to have rebooted since.

        Ignored where it is damaged.
        """
        with contextlib.suppress(msgspec.DecodeError, UnicodeDecodeError):
            self._kept = msgspec.json.decode(kept, type=Kept)

    def anchor(self, own: Own) -> None:
        """GPS has the vehicle where the autopilot believes it to be."""
        position = own.position
        if position is not None and own.driven_m is not None and own.gps_sigma_m is not None:
            where = position.lat_deg, position.lon_deg, own.gps_sigma_m
            self.by_gps = None if own.motion is None else Anchor(*where, own.motion)
            self.when_lost = None if own.without_gps is None else Anchor(*where, own.without_gps)
            self._by_gps_m = own.driven_m

    def trust(self, own: Own, *, is_doubted: bool) -> None:
        """Reckon by where GPS has the vehicle, from now on: not while places speak against GPS.

        Nor where a position of ours may still be in it, or once its velocity has run away.
        """
        if is_doubted or not own.is_aided:
            self._trusted = None
        elif own.gps_sigma_m is not None and self.by_gps is not None and not self.rests_on_fixes:
            self._trusted = self.by_gps, self._by_gps_m

    def reckoning(self, motion: Displacement | None, own: Own, velocity_error: float) -> Reckoning | None:
        """Where GPS and the vehicle's motion since have it at a displacement, without any place of the map."""
        if self._trusted is None or motion is None or own.driven_m is None:
            return None
        anchor, at_m = self._trusted
        where = moved(anchor.lat_deg, anchor.lon_deg, *motion.since(anchor.displacement))
        drift_m = max(self._drift, velocity_error) * max(0.0, own.driven_m - at_m)
        return Reckoning(*where, math.hypot(anchor.sigma_m, drift_m, motion.unknown_sigma_since(anchor.displacement)))

    def sigma_m(self, own: Own, velocity_error: float = 0.0, least_m: float = 0.0) -> float | None:
        """One standard deviation, None where nothing bounds it; velocity_error: as a share."""
        if self.bound is None or self._has_run_away or not own.is_aided or own.driven_m is None:
            return None
        driven_m = max(0.0, own.driven_m - self.bound.driven_m)
        return max(math.hypot(self.bound.sigma_m, max(self._drift, velocity_error) * driven_m), least_m)

    def axes_m(self, own: Own, fix: PlaceFix, least_m: float) -> tuple[float, float] | None:
        """Its standard deviations along the way of a fix and across it, None as in `sigma_m`."""
        is_unknown = self.bound is None or self._has_run_away or not own.is_aided
        if is_unknown or own.driven_m is None or fix.heading_deg is None:
            return None
        assert self.bound is not None
        axes_m = self.bound.axes.at(fix.heading_deg, own.driven_m, max(self._drift, fix.velocity_error))
        return max(axes_m[0], least_m), max(axes_m[1], least_m)

    def reckoned(self, fix: PlaceFix, motion: Displacement | None, own: Own) -> Reckoned | None:
        """Where GPS had the vehicle last, moved on by the autopilot's velocity; None where that is not known."""
        if self.by_gps is None or motion is None or own.driven_m is None or not fix.is_position:
            return None
        drift = max(self._drift, fix.velocity_error)
        return self.by_gps.reckoned(fix, motion, drift, max(0.0, own.driven_m - self._by_gps_m))
