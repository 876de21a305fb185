"""Whether a fix agrees with an earlier one: what to go by where nothing else bounds the autopilot's position.

Without GPS from boot the autopilot may be anywhere, and a place that is recognised wrongly looks like any other. Two
places that are far enough apart do not err together: what the vehicle reckons to have moved between them must be what
the map says.
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
"""Between two that are kept."""
TOO_FAR_M = 1000.0
"""Driven, beyond which reckoning is too uncertain to confirm anything."""


@dataclass(frozen=True)
class _Witness:
    lat_deg: float
    lon_deg: float
    sigma_m: float
    displacement: Displacement
    driven_m: float


class FixConsistency:
    """Fixes with many matches, and how the vehicle reckons to have moved since."""

    def __init__(self, gates: GatesConfig) -> None:
        self._gates = gates
        self._kept: deque[_Witness] = deque(maxlen=round(TOO_FAR_M / APART_M))

    def confirm(self, fix: PlaceFix, displacement: Displacement | None, driven_m: float | None) -> bool:
        """Whether one of those before confirms this fix, which is then one of them.

        displacement, driven_m: of the fix's moment; None where nobody tells, and then nothing can be confirmed.
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
        """The autopilot has rebooted: its reckoning begins anew."""
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
