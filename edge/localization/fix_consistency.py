"""Whether a fix agrees with an earlier one: the check if nothing else bounds the autopilot's position.

Without GPS from boot the autopilot's position may be anything, and a wrongly recognized place cannot be distinguished
from a correct one. Two wrong places that are far apart hardly agree: the displacement between them by dead reckoning
must equal the displacement on the map.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from edge.config import GatesConfig
from edge.geodesy import east_north_of
from edge.localization import PlaceFix
from edge.localization.dead_reckoning import Displacement

APART_M = 5.0
"""Minimum distance between two fixes that are kept."""
TOO_FAR_M = 1000.0
"""Distance driven beyond which dead reckoning is too uncertain to confirm a fix."""


@dataclass(frozen=True)
class _Witness:
    lat_deg: float
    lon_deg: float
    sigma_m: float
    displacement: Displacement
    driven_m: float


class FixConsistency:
    """Keeps fixes with many matches, and the vehicle's displacement at each."""

    def __init__(self, gates: GatesConfig) -> None:
        self._gates = gates
        self._kept: deque[_Witness] = deque(maxlen=round(TOO_FAR_M / APART_M))

    def confirm(self, fix: PlaceFix, displacement: Displacement | None, driven_m: float | None) -> bool:
        """Whether an earlier fix confirms this one, which is then kept too.

        displacement, driven_m: at the fix's time; if None (unknown), nothing can be confirmed.
        """
        if self._gates.confirm_m == 0:
            return True
        if displacement is None or driven_m is None or fix.lat_deg is None or fix.lon_deg is None:
            return False
        if fix.matches < self._gates.far_matches:
            return False
        seen = _Witness(fix.lat_deg, fix.lon_deg, fix.sigma_m, displacement, driven_m)
        confirmed = any(self._agree(witness, seen) for witness in self._kept)
        if not self._kept or abs(driven_m - self._kept[-1].driven_m) >= APART_M:
            self._kept.append(seen)
        return confirmed

    def forget(self) -> None:
        """Drop all fixes: the autopilot has rebooted, and its dead reckoning starts over."""
        self._kept.clear()

    def _agree(self, before: _Witness, now: _Witness) -> bool:
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
