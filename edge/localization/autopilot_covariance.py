"""How uncertain the autopilot's own position is since its last aiding, and dead reckoning from that. Pure."""

from __future__ import annotations

import contextlib
import logging
import math
from dataclasses import dataclass

import msgspec

from edge.geodesy import east_north_of, moved
from edge.journal.records import PlaceFix
from edge.localization.dead_reckoning import Odometry
from edge.localization.events import BOUND_WRONG, AutopilotState
from edge.localization.odometry_datum import DeadReckoningOffset, OdometryDatum
from edge.sequence import DeadReckoningPosition

PERIOD_NS = 1_000_000_000  # between two that are kept
SETTLED_NS = 10_000_000_000
"""After GPS is used again, nothing is left of a position of ours."""
LONGEST_NS = 600_000_000_000  # without a word of the autopilot, after which it may be another one
SAME_BOOT_NS = 2_000_000_000  # by which two times of one boot differ by delays of the link
CLOCK_RATE = 0.01  # the clock of a simulated autopilot was seen to run 0.75 % slow
FASTER = 1.5  # than the speeds before and after: what may have been driven in between
log = logging.getLogger(__name__)


@dataclass(frozen=True)
class PositionAiding:
    """The last position aiding of the autopilot: by GPS, or by a position of ours.

    sigma_m: of its position then, in each direction. driven_m, motion: in all by then. fault_probability: that the
    aiding was wrong. by_gps: whether it was GPS.
    """

    sigma_m: float
    driven_m: float
    motion: Odometry | None
    fault_probability: float
    by_gps: bool

    def sigma_at(self, driven_m: float, motion: Odometry | None, drift: float) -> float:
        """One standard deviation later, in each direction; drift: of the meters driven since."""
        unknown_m = 0.0 if motion is None or self.motion is None else motion.unknown_sigma_since(self.motion)
        return math.hypot(self.sigma_m, drift * max(0.0, driven_m - self.driven_m), unknown_m)


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
    """The standard deviation of the autopilot's own position, and the last datum by GPS.

    An aiding (GPS or a fix) holds over a silent link and over a restart of this program, while the autopilot has not
    rebooted, which its boot time shows.
    """

    def __init__(self, drift: float) -> None:
        """drift: of the meters driven, where nothing else is known of the velocity."""
        self.drift = drift
        """By what is known of it now, of the meters driven."""
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
            self.aiding = PositionAiding(sigma_m, own.driven_m, own.motion, wrong, by_gps)
            self._has_run_away = False

    def move(self, own: AutopilotState) -> None:
        """The vehicle has moved on. A position whose velocity nothing measures runs away until the next aiding."""
        self._has_run_away |= not own.is_aided

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
        since_m = None if before is None else before.since(now, self.drift)
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
        return DeadReckoningPosition(*where, self._trusted.sigma_at(motion, self.drift, own.driven_m))

    def sigma_m(self, own: AutopilotState) -> float | None:
        """One standard deviation, None where it has had no aiding."""
        if self.aiding is None or self._has_run_away or not own.is_aided or own.driven_m is None:
            return None
        return max(self.aiding.sigma_at(own.driven_m, own.motion, self.drift), own.accuracy_m or 0.0)

    def dead_reckoning_offset(
        self, fix: PlaceFix, motion: Odometry | None, own: AutopilotState
    ) -> DeadReckoningOffset | None:
        """Where GPS had the vehicle last, moved on by the autopilot's velocity; None where that is not known."""
        if self.by_gps is None or motion is None or own.driven_m is None or not fix.is_position:
            return None
        return self.by_gps.reckoned(fix, motion, self.drift, own.driven_m)
