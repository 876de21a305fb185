"""Whether a fix agrees with an earlier one, for a vehicle whose position nothing else bounds.

Without GPS from boot the autopilot may be anywhere, and a place that is recognized wrongly looks like any other. But
places far enough apart are hardly wrong in the same way: the displacement between two fixes must agree with the
vehicle's dead reckoning.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from edge.config import GatesConfig
from edge.geodesy import east_north_of
from edge.journal.records import PlaceFix
from edge.localization.dead_reckoning import Displacement

APART_M = 5.0
"""Least distance between two fixes that are kept."""
TOO_FAR_M = 1000.0
"""Distance driven beyond which dead reckoning is too uncertain to confirm anything."""


@dataclass(frozen=True)
class _Earlier:
    lat_deg: float
    lon_deg: float
    sigma_m: float
    displacement: Displacement
    driven_m: float


class FixConsistency:
    """Earlier fixes with many matches, each with the dead reckoning of its moment."""

    def __init__(self, gates: GatesConfig) -> None:
        self._gates = gates
        self._kept: deque[_Earlier] = deque(maxlen=round(TOO_FAR_M / APART_M))

    def confirm(self, fix: PlaceFix, displacement: Displacement | None, driven_m: float | None) -> bool:
        """Whether an earlier fix confirms this one, which is then kept as well.

        displacement, driven_m: of the fix's moment; None where not reported, and then nothing can be confirmed.
        """
        if self._gates.confirm_m == 0:
            return True
        if displacement is None or driven_m is None or fix.lat_deg is None or fix.lon_deg is None:
            return False
        if fix.matches < self._gates.far_matches:
            return False
        newest = _Earlier(fix.lat_deg, fix.lon_deg, fix.sigma_m, displacement, driven_m)
        confirmed = any(self._agree(earlier, newest) for earlier in self._kept)
        if not self._kept or abs(driven_m - self._kept[-1].driven_m) >= APART_M:
            self._kept.append(newest)
        return confirmed

    def reset(self) -> None:
        """The autopilot has rebooted: its dead reckoning starts again."""
        self._kept.clear()

    def _agree(self, before: _Earlier, now: _Earlier) -> bool:
        driven_m = now.driven_m - before.driven_m
        if before.displacement.leg != now.displacement.leg or not self._gates.confirm_m <= driven_m <= TOO_FAR_M:
            return False
        east_m, north_m = east_north_of(now.lat_deg, now.lon_deg, (before.lat_deg, before.lon_deg))
        off_m = math.hypot(
            east_m - (now.displacement.east_m - before.displacement.east_m),
            north_m - (now.displacement.north_m - before.displacement.north_m),
        )
        drifted_m = self._gates.drift_percent / 100 * driven_m
        return off_m <= self._gates.near_sigmas * math.hypot(before.sigma_m, now.sigma_m, drifted_m)
