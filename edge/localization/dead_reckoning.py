"""How far the vehicle has driven and moved, by its own speed and velocity, at the moment of any frame.

Both are integrated by the trapezoid rule, whatever the autopilot's position jumps to. Driving backwards leads over
places that were passed already, so the distance to sample by stands still until the vehicle is further than before.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import deque
from dataclasses import dataclass

from msgspec import Struct

SPEED_VALID_NS = 1_000_000_000  # how long a speed holds beyond its stamp
LONGEST_GAP_NS = 2_000_000_000  # the longest silence that two reports of a velocity are believed to span
LONGEST_GAP_OF_SPEED_NS = 5_000_000_000
"""The same of a speed, which is the distance to sample by alone: an autopilot that reboots is silent for 2.7 s."""
STANDING_MPS = 0.1  # a standing EKF still reports 0.04 m/s (recorded Rover 4.6.3)
MAX_SPEED_MPS = 350.0  # a speed beyond it is damage, or not a number
LEAST_SILENT_MPS = 2.0
"""So fast a vehicle may have moved unheard, though it stood before and after: a person walks with it."""
ELSEWHERE_M = 2e7
"""Half around the Earth: what lies before cannot be compared."""
KEPT = 1024
"""Reports that are kept: 20 s of a stream at 50 Hz, longer than a frame takes."""
STRONGEST_MPS2 = 9.8
"""Friction, or leaning, accelerates no vehicle by more than its weight; wheels that lose their hold change their speed
by more. In 36 recorded drives on real autopilots whose velocity was measured, no two reports are so far apart."""
DOUBTED_M = 60.0
"""Meters driven in which such a change is in doubt unless it is taken back: then places have shown what it was."""
TAKEN_BACK = 0.5
"""Share of it that may remain when it is taken back, since the vehicle's own speed changes meanwhile."""
SLOW_MPS = 1.0
"""A speed below counts as this: by which factor it changes from almost nothing says nothing."""
REPORTS_APART_NS = 1_500_000_000
"""The longest silence between two rates of gyros or fixes of a receiver, which come once a second or more often. At
one rate a second, as on eleven recorded drives, the heading is uncertain by 2 to 4 degrees after 40 s, see `Gyros`."""
TURN_FRAMES, COURSE_M, AROUND_RAD = 36, 5.0, math.radians(135)
"""Used frames, whose first and last thirds are compared; the distance that gives a course; and by how much that must
have turned."""
BACKED_M = 100.0
"""The most that must be driven again before the distance grows: a little more than a sequence, which a jump in the
distance breaks. With 30 m, five drives home that had backed twice by 60 m on the way out had 80 positions, with 100 m
273."""


@dataclass(frozen=True)
class Gyros:
    """compass_rad: the autopilot's heading less that by gyros, see `gyro_heading`. turned_rad2: variance of the latter,
    since its leg began, by what the vehicle may have turned between two rates.
    """

    compass_rad: float = 0.0
    turned_rad2: float = 0.0


class GyroReading(Struct, frozen=True, rename={"odometry_epoch": "leg"}):
    """The vehicle's own motion, in which GPS has no part: a speed is known, and `gyros` where the heading is theirs."""

    odometry_epoch: int
    gyros: Gyros | None = None


class Odometry(Struct, frozen=True, rename={"odometry_epoch": "leg"}):
    """Meters east and north that the vehicle has moved, in all epochs; between two of them its velocity was unknown.

    unknown_m: the most by which it may be wrong for all times between two epochs, and in which a speed was bridged.
    doubtful_east_m, doubtful_north_m: what of it was not driven if a change of the speed that no vehicle can make,
    `STRONGEST_MPS2`, was none.
    """

    odometry_epoch: int
    east_m: float
    north_m: float
    unknown_m: float = 0.0
    doubtful_east_m: float = 0.0
    doubtful_north_m: float = 0.0

    def since(self, before: Odometry) -> tuple[float, float]:
        """Meters east and north from another one to this."""
        return self.east_m - before.east_m, self.north_m - before.north_m

    def unknown_since(self, before: Odometry) -> float:
        """The most by which the displacement from another one to this may be wrong, while its velocity was unknown."""
        return self.unknown_m - before.unknown_m

    def unknown_sigma_since(self, before: Odometry) -> float:
        """One standard deviation of that: nothing up to the most is more likely than anything else."""
        return self.unknown_since(before) / math.sqrt(3)


class Integral:
    """A rate with one or more components, integrated over time; the last KEPT reports can be looked up."""

    def __init__(self, valid_ns: int, spans_ns: int = LONGEST_GAP_NS) -> None:
        """valid_ns: how long the newest rate holds beyond its stamp. spans_ns: the longest silence between two."""
        self._valid_ns, self._spans_ns = valid_ns, spans_ns
        self._stamps_ns: list[int] = []
        self._totals: list[tuple[float, ...]] = []
        self._rate: tuple[float, ...] = ()

    @property
    def last_ns(self) -> int | None:
        """Stamp of the newest report, None before the first."""
        return self._stamps_ns[-1] if self._stamps_ns else None

    @property
    def rate(self) -> tuple[float, ...]:
        """The newest one, () before the first."""
        return self._rate

    @property
    def total(self) -> tuple[float, ...] | None:
        """The integral up to the newest report, None before the first."""
        return self._totals[-1] if self._totals else None

    def add(self, stamp_ns: int, *rate: float) -> None:
        """A rate at a time after the newest; after a gap that is too long the integral goes on from where it was."""
        total = self.total or (0.0,) * len(rate)
        gap_ns = stamp_ns - self._stamps_ns[-1] if self._stamps_ns else 0
        if 0 < gap_ns <= self._spans_ns:
            total = tuple(
                before + (new + old) / 2 * gap_ns / 1e9
                for before, new, old in zip(total, rate, self._rate, strict=True)
            )
        self._stamps_ns.append(stamp_ns)
        self._totals.append(total)
        self._rate = rate
        if len(self._stamps_ns) > 2 * KEPT:
            del self._stamps_ns[:KEPT], self._totals[:KEPT]

    def begin(self, stamp_ns: int, total: tuple[float, ...], *rate: float) -> None:
        """Begin anew with a report, at which the integral has a value."""
        self._stamps_ns, self._totals, self._rate = [stamp_ns], [total], rate

    def at(self, stamp_ns: int) -> tuple[float, ...] | None:
        """The integral at a moment: between two reports by interpolation; None where no rate is valid."""
        index = bisect_right(self._stamps_ns, stamp_ns)
        if index == 0:
            return None
        before_ns, before = self._stamps_ns[index - 1], self._totals[index - 1]
        if index == len(self._stamps_ns):
            ahead_ns = stamp_ns - before_ns
            if ahead_ns > self._valid_ns:
                return None
            return tuple(value + rate * ahead_ns / 1e9 for value, rate in zip(before, self._rate, strict=True))
        share = (stamp_ns - before_ns) / (self._stamps_ns[index] - before_ns)
        after = self._totals[index]
        return tuple(value + share * (end - value) for value, end in zip(before, after, strict=True))


class _Slip:
    """By which factor the speed has changed as no vehicle's can, until it changes back or DOUBTED_M are driven.

    A factor of the speed, not a difference of velocities: wheels lose their hold in one heading at one speed, and find
    it again in another at another. As a difference, a spin in a bend left doubt that took that of the spin away again:
    positions were 16 m (5.1 sigma) off.
    """

    def __init__(self, speed_mps: float = 0.0) -> None:
        self._speed_mps = speed_mps
        self._log, self._most, self._driven_m = 0.0, 0.0, 0.0

    def doubtful(self, elapsed_ns: int, speed_mps: float) -> float:
        """The share of the speed, which was reported so long after the last one, that is in doubt."""
        before_mps, self._speed_mps = self._speed_mps, speed_mps
        self._driven_m += before_mps * elapsed_ns / 1e9
        if abs(speed_mps - before_mps) > STRONGEST_MPS2 * elapsed_ns / 1e9:
            self._log += math.log(max(speed_mps, SLOW_MPS) / max(before_mps, SLOW_MPS))
            self._most, self._driven_m = max(self._most, abs(self._log)), 0.0
        elif abs(self._log) < TAKEN_BACK * self._most or self._driven_m > DOUBTED_M:
            self._log, self._most = 0.0, 0.0
        return 1 - math.exp(-self._log)


class DeadReckoning:
    """Dead reckoning: distance driven by the best source of speed that reports, and displacement by velocity."""

    def __init__(self) -> None:
        self._distance = Integral(SPEED_VALID_NS, LONGEST_GAP_OF_SPEED_NS)
        self._displacement = Integral(LONGEST_GAP_NS)
        self._legs = 0
        self._unknown_m, self._is_leg_over = 0.0, True
        self._slip = _Slip()
        self.gaps = 0
        """How often the distance leads on from nothing before: a speed came too late, or BACKED_M were backed."""
        self._speed_mps, self._forward_mps = 0.0, 0.0
        self.set_off_ns: int | None = None
        """When the vehicle set off last; None where no report showed that."""
        self._behind_m = 0.0
        """How far the vehicle is behind the furthest point that it has driven to, at most BACKED_M."""
        self._source = 0
        self._answered = (0, 0.0)

    def add_speed(self, stamp_ns: int, speed_mps: float, source: int) -> None:
        """A ground speed, negative backwards; `source` ranks its origin, 0 the best.

        A worse source counts only after a second without a better one. Ignored where it is not after the newest, or is
        no speed.
        """
        if not abs(speed_mps) <= MAX_SPEED_MPS:
            return
        last_ns = self._distance.last_ns
        forward_mps = speed_mps if abs(speed_mps) >= STANDING_MPS else 0.0
        if last_ns is not None:
            gap_ns = stamp_ns - last_ns
            if gap_ns <= 0 or (source > self._source and gap_ns < SPEED_VALID_NS):
                return
            is_known = gap_ns <= LONGEST_GAP_OF_SPEED_NS
            if is_known and forward_mps and not self._forward_mps:
                self.set_off_ns = (last_ns + stamp_ns) // 2
            self.gaps += not is_known
            moved_m = (self._forward_mps + forward_mps) / 2 * gap_ns / 1e9 if is_known else 0.0
            behind_m = min(BACKED_M, max(0.0, self._behind_m - moved_m))
            self.gaps += behind_m == BACKED_M and self._behind_m < BACKED_M
            self._behind_m = behind_m
        # By its rate, so that the distance at a moment is the same whoever else asks for other moments.
        is_new_ground = forward_mps > 0 and self._behind_m == 0
        self._distance.add(stamp_ns, forward_mps if is_new_ground else 0.0, abs(forward_mps))
        self._forward_mps, self._speed_mps, self._source = forward_mps, abs(speed_mps), source

    def add_velocity(
        self,
        stamp_ns: int,
        east_mps: float,
        north_mps: float,
        reported_mps: tuple[float, float] | None = None,
        *,
        may_slip: bool = True,
        unknown_mps: float = 0.0,
    ) -> None:
        """A velocity over ground. Ignored where it is not after the newest, or is none.

        unknown_mps: the most by which it may be wrong.
        may_slip: whether a change that no vehicle can make is in doubt; a camera that saw nothing for a second has
        missed that the vehicle braked. reported_mps: as it was reported, east and north, where it was found otherwise:
        two positions that are rounded to a centimeter and 16 ms apart change it by 0.7 m/s, which would be in doubt.
        """
        if not math.hypot(east_mps, north_mps) <= MAX_SPEED_MPS:
            return
        last_ns, speed_mps = self._displacement.last_ns, math.hypot(*(reported_mps or (east_mps, north_mps)))
        if last_ns is not None and stamp_ns <= last_ns:
            return
        begins_leg = last_ns is None or self._is_leg_over or stamp_ns - last_ns > LONGEST_GAP_NS
        if begins_leg or not may_slip:
            self._slip = _Slip(speed_mps)
        if last_ns is None or begins_leg:
            self._begin_leg(stamp_ns, east_mps, north_mps)
        else:
            share = self._slip.doubtful(stamp_ns - last_ns, speed_mps)
            doubtful_mps = share * east_mps, share * north_mps
            self._displacement.add(stamp_ns, east_mps, north_mps, *doubtful_mps, unknown_mps)

    def end_leg(self, *, is_same_vehicle: bool = True) -> None:
        """The next velocity is of another filter, as after a reboot, or even of another vehicle."""
        self._is_leg_over = True
        self._unknown_m += 0.0 if is_same_vehicle else ELSEWHERE_M

    def _begin_leg(self, stamp_ns: int, east_mps: float, north_mps: float) -> None:
        """How the vehicle moved since the last epoch is unknown: at most as fast as before or after it."""
        last_ns, total, rate = self._displacement.last_ns, self._displacement.total, self._displacement.rate
        if last_ns is not None and total is not None:
            silent_s = (stamp_ns - last_ns) / 1e9
            most_mps = max(math.hypot(*rate[:2]), math.hypot(east_mps, north_mps), LEAST_SILENT_MPS)
            self._unknown_m += most_mps * silent_s
            ends = zip(total, rate, (east_mps, north_mps, 0.0, 0.0, 0.0), strict=True)
            total = tuple(moved_m + (before + after) / 2 * silent_s for moved_m, before, after in ends)
        self._displacement.begin(stamp_ns, total or (0.0,) * 5, east_mps, north_mps, 0.0, 0.0, 0.0)
        self._legs, self._is_leg_over = self._legs + 1, False

    @property
    def total_m(self) -> float | None:
        """All meters driven, in either direction, up to the newest report; None before the first."""
        total = self._distance.total
        return None if total is None else total[1]

    def driven_m(self, now_ns: int) -> float | None:
        """The same; None when no speed has come for a second."""
        return None if self.speed_mps(now_ns) is None else self.total_m

    def distance_m(self, stamp_ns: int) -> float | None:
        """Meters to sample places by at `stamp_ns`, see the module; None when no speed was known around then.

        Never less than it was before.
        """
        driven, (answered_ns, answered_m) = self._distance.at(stamp_ns), self._answered
        if driven is None or stamp_ns < answered_ns:
            return None if driven is None else driven[0]
        # One that was extrapolated while braking is held until the vehicle has really driven it.
        self._answered = stamp_ns, max(driven[0], answered_m)
        return self._answered[1]

    def displacement(self, stamp_ns: int) -> Odometry | None:
        """Meters east and north at `stamp_ns`; None when that is outside the epoch, or too long ago."""
        moved = None if self._is_leg_over else self._displacement.at(stamp_ns)
        if moved is None:
            return None
        east_m, north_m, doubtful_east_m, doubtful_north_m, bridged_m = moved
        unknown_m = self._unknown_m + bridged_m
        return Odometry(self._legs, east_m, north_m, unknown_m, doubtful_east_m, doubtful_north_m)

    def speed_mps(self, now_ns: int) -> float | None:
        """The newest ground speed, None when it is older than a second."""
        last_ns = self._distance.last_ns
        return None if last_ns is None or now_ns - last_ns > SPEED_VALID_NS else self._speed_mps


class TurnAround:
    """Whether the vehicle has turned around and now drives back, by its displacement at each used frame."""

    course_rad: float | None = None
    """Of the newest third of the frames, clockwise from north; None where that is not known."""

    def __init__(self) -> None:
        self._recent: deque[Odometry] = deque(maxlen=TURN_FRAMES)

    def add(self, displacement: Odometry | None) -> bool:
        """True at the frame at which it drives the other way; then not again before it has turned once more."""
        if displacement is None or (self._recent and displacement.odometry_epoch != self._recent[-1].odometry_epoch):
            self._recent.clear()
        third, self.course_rad = TURN_FRAMES // 3, None
        if displacement is None:
            return False
        self._recent.append(displacement)
        if len(self._recent) >= third:
            self.course_rad = _course(self._recent[-third], displacement)
        if len(self._recent) < TURN_FRAMES:
            return False
        before, after = _course(self._recent[0], self._recent[third - 1]), self.course_rad
        turned = before is not None and after is not None and abs(math.remainder(after - before, math.tau)) > AROUND_RAD
        if turned:
            self._recent.clear()
        return turned


def _course(first: Odometry, last: Odometry) -> float | None:
    """The direction of travel in radians, None where the vehicle hardly moved."""
    east_m, north_m = last.since(first)
    return math.atan2(east_m, north_m) if math.hypot(east_m, north_m) > COURSE_M else None
