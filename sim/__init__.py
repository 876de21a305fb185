"""Everything that runs at a desk. `sim` imports `edge`, never the reverse; `edge` only has the names of its commands.

world        the street world: routes, drives, scenarios, a camera, drives recorded as feeds
vehicle      the simulated autopilot: firmware, dead reckoning, position inputs, a pseudo-terminal
trial        `lookback dev sim fixes`: many seeded drives, judged by the truth
maps         `lookback map`: build, extend, inspect, split, keep, sign
home         `lookback home`: the way home as a file for a ground station
demo         `lookback demo`: the main job in simulation, with a report
datasets     published recordings as feeds, MCAP, export
evaluation   `lookback replay` a recording; `lookback eval`: its precision and recall
compare      `lookback compare`: methods side by side, the paper's and others'
coverage     `lookback map coverage`: before departure, where a map will be recognized, and where it will not
shadow       `lookback shadow`: after drives beside GPS, how far off positions would have been, and where it is ready
calibration  `lookback calibrate`: camera, rig, acceptance threshold, and the autopilot's wheels
model_tools  `lookback model`: import, quantize, verify
bench        `lookback dev bench`: this board, and each stage beside its rivals
research     what was measured to build Lookback: its belief, its network; not in the wheel
journal      reads a journal
traverse     a feed as the places of a traverse
completion   `lookback completion`
commands     the list of `lookback dev sim` commands
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

from edge.geodesy import moved

logging.getLogger("matplotlib").setLevel(logging.WARNING)  # at its first import it logs that it lists the fonts
ORIGIN_LAT_DEG = -27.4772  # Queensland University of Technology, Gardens Point
ORIGIN_LON_DEG = 153.0283
ORIGIN_ALT_M = 20.0


@dataclass(frozen=True)
class Pose:
    """Where a simulated vehicle is: meters east and north of the origin, heading clockwise from north.

    distance_m is what its wheels have covered since the drive began, in whichever direction it drives. pitch_deg: nose
    up; roll_deg: right side down.
    """

    east_m: float
    north_m: float
    heading_deg: float
    speed_mps: float
    distance_m: float
    pitch_deg: float = 0.0
    roll_deg: float = 0.0

    def geodetic(self) -> tuple[float, float]:
        """Latitude and longitude in degrees (WGS 84)."""
        return geodetic(self.east_m, self.north_m)


def geodetic(east_m: float, north_m: float, lon_shift_deg: float = 0.0) -> tuple[float, float]:
    """Latitude and longitude in degrees (WGS 84); lon_shift_deg: the origin lies so much further east."""
    return moved(ORIGIN_LAT_DEG, ORIGIN_LON_DEG + lon_shift_deg, east_m, north_m, ORIGIN_ALT_M)
