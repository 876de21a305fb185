"""The vehicle's own motion by what no filter has touched: the gyros' rates and a speed in which GPS has no part. Pure.

An autopilot's heading is no witness of its GPS: EKF3 turned it by 7 to 8.5 degrees within 10 s to follow a cross-track
spoofing drift of 1 m/s, on three recorded drives, so that wheels times heading agreed with GPS. Here the heading is the
integral of rates alone. How it lies to the north, and the bias of the gyros, are states of the `filter`.
"""

from __future__ import annotations

import math

from msgspec.structs import replace

from edge.localization.dead_reckoning import REPORTS_APART_NS, DeadReckoning, Gyros, Integral, Odometry


class GyroOdometer:
    """Gyrodometry: `DeadReckoning` in the heading by gyros, by rates and speeds."""

    def __init__(self) -> None:
        self._moved = DeadReckoning()
        self._turned = Integral(REPORTS_APART_NS, REPORTS_APART_NS)
        self._began_ns = self._legs = 0
        self._compass_rad = 0.0  # the autopilot's heading less that by the gyros, at the newest rate

    def is_turned(self, now_ns: int) -> bool:
        """Whether rates come."""
        last_ns = self._turned.last_ns
        return last_ns is not None and now_ns - last_ns <= REPORTS_APART_NS

    def end_leg(self, *, is_same_vehicle: bool = True) -> None:
        """See `DeadReckoning`; the heading begins anew."""
        self._moved.end_leg(is_same_vehicle=is_same_vehicle)
        self._turned = Integral(REPORTS_APART_NS, REPORTS_APART_NS)

    def turn(
        self, stamp_ns: int, rate_radps: float, heading_rad: float | None, body_mps: tuple[float, float] | None
    ) -> None:
        """How fast the heading turns clockwise, and how the vehicle moves: ahead and to the left, None if unknown.

        heading_rad: as the autopilot has it, without which nothing begins. Ignored where not after the newest.
        """
        last_ns = self._turned.last_ns
        if last_ns is not None and stamp_ns <= last_ns:
            return
        if last_ns is None or stamp_ns - last_ns > REPORTS_APART_NS:
            self.end_leg()
            if heading_rad is None:
                return
            self._turned.begin(stamp_ns, (heading_rad, 0.0, 0.0, 0.0), rate_radps, 0.0, 0.0, 0.0)
            self._began_ns, self._legs = stamp_ns, self._legs + 1
            last_ns = stamp_ns
        step_s, elapsed_s = (stamp_ns - last_ns) / 1e9, (stamp_ns - self._began_ns) / 1e9
        before_rad, _, _, _ = self._turned.total or (0.0,) * 4
        by_rad = before_rad + (rate_radps + self._turned.rate[0]) / 2 * step_s
        east_mps, north_mps = 0.0, 0.0
        if body_mps is not None:
            sin, cos, (ahead_mps, left_mps) = math.sin(by_rad), math.cos(by_rad), body_mps
            east_mps, north_mps = ahead_mps * sin - left_mps * cos, ahead_mps * cos + left_mps * sin
            self._moved.add_velocity(stamp_ns, east_mps, north_mps, may_slip=False)
        if step_s:
            # Between two rates, any between them is as likely.
            variance = (rate_radps - self._turned.rate[0]) ** 2 * step_s / 12
            self._turned.add(stamp_ns, rate_radps, variance, north_mps * elapsed_s, -east_mps * elapsed_s)
        if heading_rad is not None:
            self._compass_rad = math.remainder(heading_rad - by_rad, math.tau)

    def displacement(self, stamp_ns: int) -> Odometry | None:
        """Meters at a moment, not turned to the north; None where no rate or no speed is known around then.

        An epoch is one of the gyros: over a silence of the speed, the heading is still known.
        """
        moved, turned = self._moved.displacement(stamp_ns), self._turned.at(stamp_ns)
        if moved is None or turned is None:
            return None
        _, variance, *by_bias_m = turned
        gyros = Gyros((stamp_ns - self._began_ns) / 1e9, self._compass_rad, variance, *by_bias_m)
        return replace(moved, odometry_epoch=self._legs, gyros=gyros)
