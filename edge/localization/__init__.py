"""From matches and odometry to a position of the vehicle, and the checks before it is published.

`place_fix` makes positions of matches; `route_tracker` follows the vehicle along the map's drive, with
`line_refinement` for where a line really ends; `dead_reckoning` integrates what the autopilot reports of its motion;
`integrity` and `fix_consistency` are the checks that a position must pass.
"""

from __future__ import annotations

from edge.journal.records import PlaceFix
from edge.localization.dead_reckoning import DeadReckoning, Displacement
from edge.localization.fix_consistency import FixConsistency
from edge.localization.integrity import (
    GPS_SIGMA_M,
    GpsState,
    Refusal,
    Situation,
    Uncertainty,
    distance_from,
    offset_m,
    refusal,
)

__all__ = [
    "GPS_SIGMA_M",
    "DeadReckoning",
    "Displacement",
    "FixConsistency",
    "GpsState",
    "PlaceFix",
    "Refusal",
    "Situation",
    "Uncertainty",
    "distance_from",
    "offset_m",
    "refusal",
]
