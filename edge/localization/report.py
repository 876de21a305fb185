"""What an autopilot reports: the only thing that the estimator knows of it. Pure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

from edge.geodesy import VehiclePosition
from edge.localization.dead_reckoning import Displacement

GpsState: TypeAlias = Literal["healthy", "not healthy", "unknown"]


@dataclass(frozen=True)
class Report:
    """What an autopilot reports at `now_ns`; None: not known.

    gps_sigma_m: of `position` while GPS bounds it, in each direction. displacement: by its velocity at the position's
    moment. accuracy_m: of the position, by its own word. driven_m: in all. is_aided: whether anything besides our
    positions measures its velocity.
    """

    now_ns: int
    gps: GpsState = "unknown"
    gps_sigma_m: float | None = None
    position: VehiclePosition | None = None
    displacement: Displacement | None = None
    accuracy_m: float | None = None
    speed_mps: float | None = None
    driven_m: float | None = None
    is_aided: bool = True
