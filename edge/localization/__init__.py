"""From matches and the autopilot's velocity to a position of the vehicle, and whether it may be published.

`consensus` believes a place or not; `position_estimator` is what follows from a match. `place_fix` makes positions of
matches; `sighting` puts a match on the ground, and `region_lines` what its two regions say by themselves;
`route_filter` follows the vehicle with them, by one `track`, and `route_estimate` is the Kalman filter of each;
`gps_judge` says what follows from the places for GPS, by the test of `gps_referee`. `report` is what an autopilot
reports, and `dead_reckoning` integrates its motion; `integrity` decides what may be published, by the rules of
`refusals` and by what was observed (`claims`), and `protection_level` says how far off that may be, also by what
`bound`s a position without places.
"""

from __future__ import annotations

from edge.journal.records import PlaceFix
from edge.localization.bound import BOUND_WRONG
from edge.localization.dead_reckoning import DeadReckoning, Displacement, Integral
from edge.localization.gps_referee import GpsFix, GpsVerdict
from edge.localization.integrity import (
    GPS_SIGMA_M,
    Decision,
    Integrity,
    Limits,
    Situation,
    distance_from,
    offset_m,
)
from edge.localization.position_estimator import PositionEstimator
from edge.localization.protection_level import ProtectionLevel
from edge.localization.refusals import Refusal
from edge.localization.report import GpsState, Report
from edge.localization.route_estimate import AGREE_SIGMAS, CORRELATION_M

__all__ = [
    "AGREE_SIGMAS",
    "BOUND_WRONG",
    "CORRELATION_M",
    "GPS_SIGMA_M",
    "DeadReckoning",
    "Decision",
    "Displacement",
    "GpsFix",
    "GpsState",
    "GpsVerdict",
    "Integral",
    "Integrity",
    "Limits",
    "PlaceFix",
    "PositionEstimator",
    "ProtectionLevel",
    "Refusal",
    "Report",
    "Situation",
    "distance_from",
    "offset_m",
]
