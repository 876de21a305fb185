"""Everything that runs at a desk: the street world and its cameras, a simulated autopilot, demo and evaluation.

`sim` imports `edge`, never the reverse; `edge` finds it through the entry points in pyproject.toml.
"""

from __future__ import annotations

from dataclasses import dataclass

import pymap3d

ORIGIN_LAT_DEG = -27.4772  # Queensland University of Technology, Gardens Point
ORIGIN_LON_DEG = 153.0283
ORIGIN_ALT_M = 20.0


@dataclass(frozen=True)
class Pose:
    """Where a simulated vehicle is: metres east and north of the origin, heading clockwise from north.

    distance_m is what its wheels have covered since the drive began, in whichever direction it drives.
    """

    east_m: float
    north_m: float
    heading_deg: float
    speed_mps: float
    distance_m: float

    def geodetic(self) -> tuple[float, float]:
        """Latitude and longitude in degrees (WGS 84)."""
        lat_deg, lon_deg, _ = pymap3d.enu2geodetic(
            self.east_m, self.north_m, 0.0, ORIGIN_LAT_DEG, ORIGIN_LON_DEG, ORIGIN_ALT_M
        )
        return float(lat_deg), float(lon_deg)
