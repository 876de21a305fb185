"""The covariance of the autopilot's own position since its last aiding, and dead reckoning from that. Pure."""

from __future__ import annotations

import contextlib
import logging
import math
from dataclasses import dataclass, field, replace
from typing import NamedTuple, TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray

from edge.geodesy import east_north_of, moved
from edge.journal.records import PlaceFix
from edge.localization.dead_reckoning import Odometry
from edge.localization.events import BOUND_WRONG, AutopilotState, Fix
from edge.localization.odometry_datum import DeadReckoningOffset, OdometryDatum
from edge.sequence import DeadReckoningPosition

PERIOD_NS = 1_000_000_000  # between two that are kept
SETTLED_NS = 10_000_000_000
"""After GPS is used again, nothing is left of a position of ours."""
LONGEST_NS = 600_000_000_000  # without a word of the autopilot, after which it may be another one
SAME_BOOT_NS = 2_000_000_000  # by which two times of one boot differ by delays of the link
CLOCK_RATE = 0.01  # the clock of a simulated autopilot was seen to run 0.75 % slow
FASTER = 1.5  # than the speeds before and after: what may have been driven in between
Matrix: TypeAlias = NDArray[np.float64]
log = logging.getLogger(__name__)


@dataclass(frozen=True)
class PositionAiding:
    """The last position aiding of the autopilot: by GPS, or by a position of ours.

    covariance: of the position now. fault_probability: that the aiding was wrong. by_gps: whether it was GPS.
    """

    covariance: PropagatedCovariance
    fault_probability: float
    by_gps: bool


class Drift(NamedTuple):
    """One standard deviation of a velocity's scale, of its heading in radians, and of what else a way adds as a share.

    Where nothing was shown of scale and heading, the last one stands for all.
    """

    scale: float
    heading_rad: float
    way: float

    @property
    def most(self) -> float:
        """Of the meters driven, in any direction."""
        return math.hypot(max(self.scale, self.heading_rad), self.way)


@dataclass(frozen=True)
class PropagatedCovariance:
    """Of a position east and north, each (2, 2): the covariance at its aiding, and what was added to it since.

    by_velocity: meters for each of the velocity's scale, and for each radian of its heading. by_way: for each share of
    the meters driven. An error of scale or heading adds up over a way, and is gone where a position has measured it.
    """

    covariance: Matrix
    by_velocity: Matrix = field(default_factory=lambda: np.zeros((2, 2)))
    by_way: Matrix = field(default_factory=lambda: np.zeros((2, 2)))

    def moved(self, east_m: float, north_m: float, driven_m: float, unknown_m: float) -> PropagatedCovariance:
        """After so many meters more; unknown_m: one standard deviation of those while the velocity was unknown."""
        by_velocity = self.by_velocity + np.array([[east_m, north_m], [north_m, -east_m]])
        covariance = self.covariance + unknown_m**2 * np.eye(2)
        return PropagatedCovariance(covariance, by_velocity, self.by_way + driven_m * np.eye(2))

    def bound_by(self, fix: Fix, left_m: float) -> PropagatedCovariance:
        """After the autopilot used a fix of ours and is `left_m` from it: its held axes go on from before.

        Of `by_way` the length stays, not its direction: that of the unmodeled velocity error is unknown, and changes
        in a bend.
        """
        place = fix.place
        assert place.heading_deg is not None
        axes = _axes(place.heading_deg)
        held, sigmas_m = np.array(fix.held_axes), np.maximum([place.sigma_along_m, place.sigma_cross_track_m], left_m)
        kept, set_by = axes[held].T @ axes[held], axes[~held].T @ np.diag(sigmas_m[~held] ** 2) @ axes[~held]
        by_way = axes[held].T @ np.diag(np.linalg.norm(axes[held] @ self.by_way, axis=1)) @ axes[held]
        return PropagatedCovariance(kept @ self.covariance @ kept + set_by, kept @ self.by_velocity, by_way)

    def _covariance(self, drift: Drift) -> Matrix:
        by_velocity, by_way = self.by_velocity * (drift.scale, drift.heading_rad), drift.way * self.by_way
        covariance: Matrix = self.covariance + by_velocity @ by_velocity.T + by_way @ by_way.T
        return covariance

    def most_m(self, drift: Drift) -> float:
        """One standard deviation in the direction where it is largest."""
        return math.sqrt(np.linalg.eigvalsh(self._covariance(drift))[-1])

    def along_and_across_m(self, heading_deg: float, drift: Drift) -> tuple[float, float]:
        """One standard deviation along-track and cross-track of a heading."""
        axes = _axes(heading_deg)
        along_m, across_m = np.sqrt((axes @ self._covariance(drift) @ axes.T).diagonal())
        return float(along_m), float(across_m)


def _axes(heading_deg: float) -> Matrix:
    """Unit vectors along a heading and to its right, (2, 2)."""
    sin, cos = math.sin(math.radians(heading_deg)), math.cos(math.radians(heading_deg))
    return np.array([[sin, cos], [cos, -sin]])


class AidingSnapshot(msgspec.Struct, frozen=True):
    """The sigma of an autopilot's position at `stamp_ns` of CLOCK_MONOTONIC; see `AutopilotCovariance.snapshot`.

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

    def since(self, now: AidingSnapshot, drift: float) -> float | None:
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


class AutopilotCovariance:
    """The covariance of the autopilot's own position, and the last datum by GPS.

    An aiding (GPS or a fix) holds over a silent link and over a restart of this program, while the autopilot has not
    rebooted, which its boot time shows.
    """

    def __init__(self, drift: float) -> None:
        """drift: of the meters driven, where nothing else is known of the velocity."""
        self.drift = Drift(0.0, 0.0, drift)
        """By what is known of it now."""
        self._at: AutopilotState | None = None
        self.aiding: PositionAiding | None = None
        """The last one since its boot, None where there was none."""
        self._has_run_away = False  # since then: nothing measured its velocity for a while
        self.by_gps: OdometryDatum | None = None
        """Where GPS had the vehicle last."""
        self._trusted: OdometryDatum | None = None  # the last that no place can have moved
        self.rests_on_fixes = False
        """Whether a position that was sent may have moved the autopilot's own since GPS aided it last."""
        self._sent_ns: int | None = None
        self._kept: AidingSnapshot | None = None
        self._due_ns = 0

    def restart(self) -> None:
        """The autopilot has rebooted. What GPS showed of the vehicle holds on, see `Odometry.unknown_m`."""
        self.aiding, self._sent_ns = None, None

    def sent(self, t_ns: int) -> None:
        """A position was sent: nobody knows yet whether the autopilot uses it."""
        self._sent_ns, self.rests_on_fixes = t_ns, True

    def bind(self, sigma_m: float, own: AutopilotState, wrong: float = BOUND_WRONG, *, by_gps: bool = False) -> None:
        """Aid it: that is its sigma now, in each direction. wrong: the probability that the aiding is wrong."""
        if own.driven_m is not None:
            self.aiding = PositionAiding(PropagatedCovariance(sigma_m**2 * np.eye(2)), wrong, by_gps)
            self._has_run_away = False

    def bind_by_fix(self, fix: Fix, left_m: float, own: AutopilotState) -> None:
        """It has used a fix or agrees with it, and is `left_m` from it now."""
        before, place = self.aiding, fix.place
        self.bind(max(place.sigma_m, left_m), own, fix.bound_wrong)
        if self.aiding is not None and own.driven_m is not None and place.heading_deg is not None:
            self.aiding = replace(self.aiding, covariance=(before or self.aiding).covariance.bound_by(fix, left_m))

    def move(self, own: AutopilotState) -> None:
        """The vehicle has moved on. A position whose velocity nothing measures runs away until the next aiding."""
        self._has_run_away |= not own.is_aided
        before, self._at = self._at, own
        if before is None or before.driven_m is None or own.driven_m is None or self.aiding is None:
            return
        motions = before.motion, own.motion
        moved_m, unknown_m = (0.0, 0.0), 0.0
        if motions[0] is not None and motions[1] is not None:
            moved_m, unknown_m = motions[1].since(motions[0]), motions[1].unknown_sigma_since(motions[0])
        errors = self.aiding.covariance.moved(*moved_m, max(0.0, own.driven_m - before.driven_m), unknown_m)
        self.aiding = replace(self.aiding, covariance=errors)

    def keep(self, t_ns: int, own: AutopilotState, *, is_by_gps: bool) -> float | None:
        """Keep its sigma for `snapshot`, once a second; where nothing aids it, return the kept one if that still holds.

        is_by_gps: whether GPS aids it now.
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
        now = AidingSnapshot(own.system_id, own.booted_ns, t_ns, sigma_m or 0.0, *where)
        if sigma_m is not None:
            self._kept = now
            return None
        since_m = None if before is None else before.since(now, self.drift.most)
        if before is not None and since_m is not None:
            self.rests_on_fixes |= before.by_fixes
        return since_m

    def snapshot(self) -> bytes:
        """The kept sigma and position, b"" for none."""
        return b"" if self._kept is None else msgspec.json.encode(self._kept)

    def restore(self, kept: bytes) -> None:
        """Aid by what was kept, once the autopilot is known to be the same, and not to have rebooted since.

        Ignored where it is damaged.
        """
        with contextlib.suppress(msgspec.DecodeError, UnicodeDecodeError):
            self._kept = msgspec.json.decode(kept, type=AidingSnapshot)

    def anchor(self, own: AutopilotState) -> None:
        """GPS has the vehicle where the autopilot believes it to be."""
        position = own.position
        if position is not None and own.driven_m is not None and own.gps_sigma_m is not None:
            where = position.lat_deg, position.lon_deg, own.gps_sigma_m
            self.by_gps = None if own.motion is None else OdometryDatum(*where, own.motion, own.driven_m)

    def trust(self, own: AutopilotState, *, is_doubted: bool) -> None:
        """Make the newest position by GPS the datum of dead reckoning: not while places speak against GPS.

        Nor where a position of ours may still be in it, or once its velocity has run away.
        """
        if is_doubted or not own.is_aided:
            self._trusted = None
        elif own.gps_sigma_m is not None and self.by_gps is not None and not self.rests_on_fixes:
            self._trusted = self.by_gps

    def carry(self) -> None:
        """The vehicle was carried: dead reckoning says nothing of where it is now."""
        self._trusted = None

    def dead_reckoning_position(self, motion: Odometry | None, own: AutopilotState) -> DeadReckoningPosition | None:
        """Where GPS and the vehicle's motion since have it at a displacement, without any place of the map."""
        if self._trusted is None or motion is None or own.driven_m is None:
            return None
        where = moved(self._trusted.lat_deg, self._trusted.lon_deg, *motion.since(self._trusted.displacement))
        return DeadReckoningPosition(*where, self._trusted.sigma_at(motion, self.drift.most, own.driven_m))

    def _errors(self, own: AutopilotState) -> PropagatedCovariance | None:
        if self.aiding is None or self._has_run_away or not own.is_aided or own.driven_m is None:
            return None
        return self.aiding.covariance

    def sigma_m(self, own: AutopilotState, least_m: float = 0.0) -> float | None:
        """One standard deviation, None where it has had no aiding."""
        errors = self._errors(own)
        return None if errors is None else max(errors.most_m(self.drift), least_m)

    def axes_m(self, own: AutopilotState, fix: PlaceFix, least_m: float) -> tuple[float, float] | None:
        """Its standard deviations along-track and cross-track of a fix, None as in `sigma_m`."""
        errors = self._errors(own)
        if errors is None or fix.heading_deg is None:
            return None
        axes_m = errors.along_and_across_m(fix.heading_deg, self.drift)
        return max(axes_m[0], least_m), max(axes_m[1], least_m)

    def dead_reckoning_offset(
        self, fix: PlaceFix, motion: Odometry | None, own: AutopilotState
    ) -> DeadReckoningOffset | None:
        """Where GPS had the vehicle last, moved on by the autopilot's velocity; None where that is not known."""
        if self.by_gps is None or motion is None or own.driven_m is None or not fix.is_position:
            return None
        return self.by_gps.reckoned(fix, motion, self.drift.most, own.driven_m)
