"""The autopilot's heading against one that no filter has touched: the integral of the gyros' rates alone. Pure.

An autopilot's heading is no witness of its GPS: EKF3 turned it by 7 to 8.5 degrees within 10 s to follow a cross-track
spoofing drift of 1 m/s, on three recorded drives, so that wheels times heading agreed with GPS. How a heading by gyros
lies to the north, and their bias, are states of the `filter`.
"""

from __future__ import annotations

import math

from edge.localization.dead_reckoning import LONGEST_GAP_NS, REPORTS_APART_NS, GyroReading, Gyros, Integral


class GyroHeading:
    """A gyro-derived heading: integrates rates, and knows when a speed comes in which GPS has no part."""

    def __init__(self) -> None:
        self._legs = 0
        self._compass_rad = 0.0  # the autopilot's heading less that by the gyros, at the newest rate
        self.end_leg()

    def is_turned(self, now_ns: int) -> bool:
        """Whether rates come."""
        last_ns = self._turned.last_ns
        return last_ns is not None and now_ns - last_ns <= REPORTS_APART_NS

    def end_leg(self) -> None:
        """The heading begins anew, and the next speed is of another session."""
        self._turned = Integral(REPORTS_APART_NS, REPORTS_APART_NS)
        self._moves = Integral(LONGEST_GAP_NS)

    def turn(self, stamp_ns: int, rate_radps: float, heading_rad: float | None, *, has_speed: bool) -> None:
        """How fast the heading turns clockwise; has_speed: whether a speed in which GPS has no part is known.

        heading_rad: as the autopilot has it, without which nothing begins. Ignored where not after the newest.
        """
        last_ns = self._turned.last_ns
        if last_ns is not None and stamp_ns <= last_ns:
            return
        if last_ns is None or stamp_ns - last_ns > REPORTS_APART_NS:
            self.end_leg()
            if heading_rad is None:
                return
            self._turned.begin(stamp_ns, (heading_rad, 0.0), rate_radps, 0.0)
            self._legs += 1
        else:  # between two rates, any between them is as likely
            variance = (rate_radps - self._turned.rate[0]) ** 2 * (stamp_ns - last_ns) / 1e9 / 12
            self._turned.add(stamp_ns, rate_radps, variance)
        if has_speed:
            if self._moves.last_ns is not None and stamp_ns - self._moves.last_ns > LONGEST_GAP_NS:
                self._moves = Integral(LONGEST_GAP_NS)
            self._moves.add(stamp_ns)
        if heading_rad is not None and self._turned.total is not None:
            self._compass_rad = math.remainder(heading_rad - self._turned.total[0], math.tau)

    def at(self, stamp_ns: int) -> GyroReading | None:
        """At a moment; None where no rate or no speed is known around then.

        A leg is one of the gyros: over a silence of the speed, the heading is still known.
        """
        turned = self._turned.at(stamp_ns)
        if turned is None or self._moves.at(stamp_ns) is None:
            return None
        return GyroReading(self._legs, Gyros(self._compass_rad, turned[1]))
