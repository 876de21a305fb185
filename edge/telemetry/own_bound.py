"""What bounds the autopilot's own position; also remembered over a restart of this program and over a silent link.

What bounded the position (GPS or a fix) still does while the autopilot has not rebooted, which its boot time shows.
Meanwhile the vehicle may have driven unheard: at most as fast as before or now, or as its own position has moved.
The file is replaced without a flush to the disk: it has to outlive this program, not this computer's power.
"""

from __future__ import annotations

import contextlib
import logging
import math
from collections.abc import Callable
from functools import partial
from pathlib import Path

import msgspec
from msgspec.structs import replace

from edge.files import Behind
from edge.geodesy import east_north_of
from edge.localization import PositionEstimator
from edge.telemetry.acknowledgements import PositionUse
from edge.telemetry.vehicle import Session, Vehicle

PERIOD_NS = 1_000_000_000
SETTLED_NS = 10_000_000_000  # after GPS is used again, nothing is left of a position of ours
LONGEST_NS = 600_000_000_000
SAME_BOOT_NS = 2_000_000_000
CLOCK_RATE = 0.01  # the clock of a simulated autopilot was seen to run 0.75 % slow
FASTER = 1.5  # than the speeds before and after: what may have been driven in between
BOOT_ID = Path("/proc/sys/kernel/random/boot_id")
log = logging.getLogger(__name__)


class Bound(msgspec.Struct, frozen=True):
    """One standard deviation of the autopilot's position at `stamp_ns` of CLOCK_MONOTONIC, in this boot of ours.

    by_fixes: whether it rests on positions of ours, or may.
    """

    computer_boot: str
    system_id: int
    autopilot_booted_ns: int
    stamp_ns: int
    sigma_m: float
    speed_mps: float
    lat_deg: float
    lon_deg: float
    by_fixes: bool = True


class OwnBound:
    """What bounds the autopilot's own position: GPS, or what did before a silence or a restart, in a file."""

    def __init__(
        self,
        path: Path | None,
        drift_percent: float,
        vehicle: Vehicle,
        estimator: PositionEstimator,
        warn: Callable[[str], object],
    ) -> None:
        """path: None keeps it over a silent link only. drift_percent: of the distance driven unheard."""
        self._path, self._drift = path, drift_percent / 100
        self._vehicle, self._estimator, self._warn = vehicle, estimator, warn
        self._computer_boot = BOOT_ID.read_text(encoding="ascii").strip()
        self._bound: Bound | None = None
        self._due_ns, self._behind = 0, Behind()
        self._had_gps: Session | None = None  # the session in which a receiver worked last
        if path is not None:
            with contextlib.suppress(OSError, msgspec.DecodeError, UnicodeDecodeError):
                self._bound = msgspec.json.decode(path.read_bytes(), type=Bound)

    def follow(self, use: PositionUse, now_ns: int, *, runs_away: bool) -> None:
        """To be called often. runs_away: nothing measures the autopilot's velocity, as far as that is known."""
        estimator, velocity, report = self._estimator, self._vehicle.velocity, self._vehicle.report(now_ns)
        estimator.bind_by_gps(report)
        is_settled = use.newest is None or now_ns - use.newest.at_ns > SETTLED_NS
        if is_settled and report.gps_sigma_m is not None and not estimator.ignores_gps:
            velocity.has_our_position = False
        self._warn_of_lost_gps(now_ns)
        if runs_away and self._bound is not None:
            self._drop()
        if now_ns < self._due_ns or not report.is_aided:
            return
        self._due_ns = now_ns + PERIOD_NS
        sigma_m = estimator.bounded_m(report)
        if sigma_m is not None:
            self._keep(sigma_m, now_ns)
        elif (remembered := self._recall(now_ns)) is not None:
            velocity.has_our_position |= remembered.by_fixes
            use.bind(remembered.sigma_m, now_ns)

    def _warn_of_lost_gps(self, now_ns: int) -> None:
        """Where GPS is lost, and the autopilot had not used it yet."""
        session, had_gps = self._vehicle.session, self._had_gps
        receivers = session.gps.receiver_state(now_ns)
        if had_gps is session and receivers == "not healthy" and not self._estimator.is_bounded:
            log.warning("GPS is lost, and the autopilot had not used it yet: nothing bounds its position")
            self._warn("Lookback: GPS lost before the autopilot used it")
        if receivers != "unknown":
            self._had_gps = session if receivers == "healthy" else None

    def _keep(self, sigma_m: float, now_ns: int) -> None:
        """Replace what is remembered; not where the autopilot has no position, time or speed."""
        bound = self._present(sigma_m, now_ns)
        if bound is None:
            return
        self._bound = bound
        if self._path is not None:
            self._behind.start(partial(_replace, self._path, msgspec.json.encode(bound)))

    def _drop(self) -> None:
        """Nothing measures the velocity any more: the autopilot's position runs away from what is remembered."""
        self._bound = None
        if self._path is not None:
            self._behind.start(partial(_delete, self._path))

    def _recall(self, now_ns: int) -> Bound | None:
        """What was kept, as far as the vehicle can have gone since.

        None where the autopilot has rebooted, or too long ago, or not known yet.
        """
        before, now = self._bound, self._present(0.0, now_ns)
        if before is None or now is None or not self._is_same_boot(before, now):
            return None
        gap_s = (now_ns - before.stamp_ns) / 1e9
        moved_m = math.hypot(*east_north_of(now.lat_deg, now.lon_deg, (before.lat_deg, before.lon_deg)))
        driven_m = max(FASTER * max(before.speed_mps, now.speed_mps) * gap_s, moved_m)
        log.info("the autopilot has not rebooted: %.1f s ago its position was known to %.1f m", gap_s, before.sigma_m)
        return replace(before, sigma_m=math.hypot(before.sigma_m, self._drift * driven_m))

    def _is_same_boot(self, before: Bound, now: Bound) -> bool:
        """Whether both are of one boot of the autopilot and of this computer; False where that is not certain."""
        gap_ns = now.stamp_ns - before.stamp_ns
        is_same_pair = (before.computer_boot, before.system_id) == (now.computer_boot, now.system_id)
        if not (is_same_pair and 0 <= gap_ns <= LONGEST_NS):
            return False
        apart_ns = abs(now.autopilot_booted_ns - before.autopilot_booted_ns)
        return apart_ns <= SAME_BOOT_NS + CLOCK_RATE * gap_ns and now.autopilot_booted_ns < before.stamp_ns

    def _present(self, sigma_m: float, now_ns: int) -> Bound | None:
        vehicle = self._vehicle
        boot_s, position = vehicle.boot_time_s(now_ns), vehicle.position(now_ns)
        speed_mps = vehicle.motion.speed_mps(now_ns)
        if boot_s is None or position is None or speed_mps is None or vehicle.system_id is None:
            return None
        booted_ns = now_ns - round(boot_s * 1e9)
        own = position.lat_deg, position.lon_deg
        system = self._computer_boot, vehicle.system_id
        return Bound(*system, booted_ns, now_ns, sigma_m, speed_mps, *own, vehicle.velocity.has_our_position)


def _replace(path: Path, data: bytes) -> None:
    new = path.with_name(f"{path.name}.new")
    with contextlib.suppress(OSError):  # a full disk costs the memory, not the flight
        new.write_bytes(data)
        new.replace(path)


def _delete(path: Path) -> None:
    with contextlib.suppress(OSError):
        path.unlink(missing_ok=True)
