"""Where on a drive the newest line really ends. Pure.

A line through the last frames is best known in its middle: one that is too steep by a little ends too far by half its
length times that. The odometer knows the slope better than the pictures do, so the line is turned about its middle to
the odometer's slope. On simulated drives home (night, dusk, rain) the end is then right to 3.0 m where it was to 5.0.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from edge.reference_map import Drive, Route
from edge.sequence import PlaceMatch

WIDTH_SHARE, WIDTH_SHARE_TURNED = 0.36, 0.06
"""Deviation over the match's half_width_places, alone and once the line is turned: measured on the same drives."""
STEEPEST = 0.2
"""A line whose slope differs from the odometer's by more than this share is no sighting: so look the first lines on a
stretch, which lean on the few frames that are on the map already, and were up to 20 m off."""
PUSHED = 3.0
"""Places from the end of a drive, within which a line that begins there may have been pushed."""


@dataclass(frozen=True)
class LineEnd:
    """Meters along the drive at which a line ends, in the drive's own route_m.

    spacing_m: between places there. width_m: the error that the match's half width
    stands for, one standard deviation.
    """

    segment: int
    along_m: float
    spacing_m: float
    width_m: float

    @property
    def sigma_m(self) -> float:
        """What places apart and a line not quite known leave, one standard deviation; the rig's own comes on top."""
        return math.hypot(self.spacing_m / math.sqrt(12), self.width_m)


class LineRefinement:
    """Keeps the odometer's reading at each frame of the newest line."""

    def __init__(self, route: Route, length: int) -> None:
        """length: frames in a sequence."""
        self._route = route
        self._readings_m: deque[float] = deque(maxlen=length)
        self._driven_m: float | None = None
        self._spacing_m = 0.0
        self.odometer_m = 0.0
        """Meters driven: by the odometer, or where there is none by the lines' own slopes."""

    def move(self, match: PlaceMatch | None, driven_m: float | None, missed: int = 0) -> bool:
        """A frame was used at that reading, None where nobody tells; False when the odometer was counted anew.

        missed: places passed before it without a frame, which the line has room for.
        """
        goes_on, before_m = True, self.odometer_m
        if driven_m is not None and self._driven_m is not None and driven_m >= self._driven_m:
            self.odometer_m += driven_m - self._driven_m
        elif driven_m is None and match is not None:
            self.odometer_m += match.slope * self._spacing_m
        else:
            self._readings_m.clear()
            goes_on = False
        self._driven_m = driven_m
        if not self._readings_m or self.odometer_m > self._readings_m[-1]:  # a frame while standing is in no line
            rooms = missed + 1 if self._readings_m else 1
            self._readings_m.extend(np.linspace(before_m, self.odometer_m, rooms + 1)[1:].tolist())
        return goes_on

    def odometer_at(self, driven_m: float | None) -> float | None:
        """`odometer_m` at another reading; None while there is no odometer."""
        if driven_m is None or self._driven_m is None:
            return None
        return self.odometer_m + driven_m - self._driven_m

    def end_of(self, match: PlaceMatch) -> LineEnd | None:
        """Where the match's line ends; None where the map knows no meters, and for a line that is no sighting."""
        drive, place_m = self._route.drive(match.place_index), self._route.route_m(match.place_index)
        if drive.places < 2 or math.isnan(place_m):
            return None
        self._spacing_m = drive.spacing_m
        sign = 1 if match.direction == "forward" else -1
        if self._driven_m is None or len(self._readings_m) < 2:
            width_m = WIDTH_SHARE * match.half_width_places * self._spacing_m
            return LineEnd(drive.segment, place_m + match.offset_places * self._spacing_m, self._spacing_m, width_m)
        driven_m = self._readings_m[-1] - self._readings_m[0]
        too_long_m = match.slope * self._spacing_m * (len(self._readings_m) - 1) - driven_m
        along_m = place_m - sign * too_long_m / 2
        if abs(too_long_m) > STEEPEST * driven_m or not self._begins_within(along_m - sign * driven_m, drive):
            return None
        width_m = WIDTH_SHARE_TURNED * match.half_width_places * self._spacing_m
        return LineEnd(drive.segment, along_m, self._spacing_m, width_m)

    def _begins_within(self, begins_m: float, drive: Drive) -> bool:
        """Whether a line begins well inside its drive; one at the very end may have been pushed there.

        Where only the newer frames are on the map, a whole line can but begin at its end, and ends too far.
        """
        margin_m = PUSHED * self._spacing_m
        return drive.from_m + margin_m <= begins_m <= drive.to_m - margin_m
