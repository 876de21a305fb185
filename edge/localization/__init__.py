"""From matches and the autopilot's velocity to a position of the vehicle, and whether it may be published.

`consensus` believes a place or not. `localizer` joins what follows from a match: `place_fix` makes positions of
matches; `route_filter` follows the vehicle over the ground, with `route_estimate` as its Kalman filter; `gps_referee`
judges GPS by the places. `dead_reckoning` integrates what the autopilot reports of its motion; `integrity` decides what
may be published, by what was observed (`claims`), and `protection_level` says how far off that may be.
"""

from __future__ import annotations

from edge.journal.records import PlaceFix
from edge.localization.dead_reckoning import DeadReckoning, Displacement
from edge.localization.gps_referee import GpsFix, GpsVerdict
from edge.localization.integrity import (
    GPS_SIGMA_M,
    GpsState,
    Integrity,
    Refusal,
    Situation,
    Uncertainty,
    distance_from,
    offset_m,
)
from edge.localization.protection_level import ProtectionLevel, Reckoning
from edge.localization.route_estimate import CORRELATION_M

__all__ = [
    "CORRELATION_M",
    "GPS_SIGMA_M",
    "DeadReckoning",
    "Displacement",
    "GpsFix",
    "GpsState",
    "GpsVerdict",
    "Integrity",
    "PlaceFix",
    "ProtectionLevel",
    "Reckoning",
    "Refusal",
    "Situation",
    "Uncertainty",
    "distance_from",
    "offset_m",
]
