"""How high the camera is above the ground: the scale of what it measures, with its uncertainty, kept between drives.

Three things show it, weighed by their variances: GPS while it is good, over WINDOW_M at a time; places that are
recognized, which the map has as far apart as the camera must have moved; and earlier drives, right to EARLIER_SHARE,
since a camera may have been mounted anew. Places are compared by the distances along one drive of the map, and never by
positions, which are made with the odometer.
"""

from __future__ import annotations

import math
from collections import deque
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from edge.files import PersistentFile

EARLIER_SHARE = 0.1
"""One standard deviation, as a share: another mount, tires or load. So much is sent to no autopilot (MOST_SCALE)."""
WINDOW_M, WINDOW_SHARE, WINDOWS, WINDOWS_MOST = 20.0, 0.015, 2, 25
"""Driven by GPS for one comparison: 2 s at 10 m/s, in which its velocity is right to a percent. What one is off by at
least (0.5 to 1.1 % on simulated roads); how many make a height known, and how many are used: 500 m."""
LEAST_MAP_SHARE, KNOWN_SHARE = 0.005, 0.15
"""Standard deviations: the least that is reached, since GPS has no better velocity; and the most that is of use, as an
odometer."""
MATCH_M, MAP_SHARE, LINES_M = 3.5, 0.01, 60.0
"""Standard deviation of where the line of a match lies along the map's drive, the same for all within LINES_M, and that
of the drive's own length, measured with GPS."""
SLIPPED = 0.05
"""What a mount may slip by, as a share: two windows in a row that are off by more begin anew, and one standard
deviation while GPS does not measure, where only places show it. So a fifth is four of them, and still sent."""
FORGOTTEN_M = 100.0  # driven within which a line's weight falls to a third: a mount may slip at any time
CONTRADICTS = 2.0
"""Standard deviations that places may differ from what GPS said before: it is as uncertain as that asks for, since the
mount may have slipped. Of a tenth, half is found within 250 m, and all but 3 % within 400."""
STRETCHED = 0.25  # the most that the height may be wrong by before two places are not of one drive
SPANNED_NS = 2_000_000_000
"""After so long without a motion, how far it drove is not known; 0.3 m too far at braking of 1 m/s^2 until then."""
SAVED_NS = 60_000_000_000  # between writes of the file


class HeightMeasurement(NamedTuple):
    """A height in meters, and its standard deviation as a share of it."""

    height_m: float
    share: float


class SequencePosition(NamedTuple):
    """The line of a match: so many frames ago it was `along_m` along a drive of the map, the way the vehicle goes."""

    drive: str
    along_m: float
    back: float


class HeightRecord(msgspec.Struct, frozen=True):
    """The file: what it holds for, the camera's pitch down from the horizon, and the newest comparisons with GPS.

    yaw_rad: how far to the right of the vehicle it looks, as the autopilot has that head; None until GPS has shown it.
    """

    camera: str
    pitch_rad: float
    heights_m: tuple[float, ...] = ()
    yaw_rad: float | None = None


class CameraHeight:
    """The height of one camera, by what has been compared so far."""

    def __init__(self, kept: HeightRecord, frames: int, path: Path | None = None) -> None:
        """kept: by earlier drives. frames: of the line of a match. path: of the file."""
        self.kept, self.pitch_rad, self.yaw_rad = kept, kept.pitch_rad, kept.yaw_rad
        self._file, self._saved_ns = kept_height(path), 0
        earlier = _by_windows(kept.heights_m)
        self._earlier = earlier and HeightMeasurement(earlier.height_m, math.hypot(earlier.share, EARLIER_SHARE))
        self._windows_m, self._places, self._has_gps = tuple[float, ...](), _ByPlaces(frames), False
        self._window = np.zeros(3)  # since the last comparison: meters, heights, and the yaw times meters
        self._combine()

    @property
    def height_m(self) -> float | None:
        """None until it is known well enough."""
        return self._best.height_m if self._best is not None and self._best.share <= KNOWN_SHARE else None

    @property
    def share(self) -> float:
        """One standard deviation, as a share of the height; infinite where nothing is known."""
        if self._best is None:
            return math.inf
        places = self._places.measured
        off = math.inf if places is None else math.hypot(places.share, places.height_m / self._best.height_m - 1)
        return max(self._best.share, 0.0 if self._has_gps else (SLIPPED**-2 + off**-2) ** -0.5)

    def _combine(self) -> None:
        is_enough = len(self._windows_m) >= WINDOWS or self._earlier is not None
        gps, places = _by_windows(self._windows_m) if is_enough else None, self._places.measured
        if gps is not None and places is not None:
            agrees = abs(places.height_m / gps.height_m - 1) / CONTRADICTS
            gps = HeightMeasurement(gps.height_m, max(gps.share, math.sqrt(max(0.0, agrees**2 - places.share**2))))
        known = [one for one in (self._earlier, gps, places) if one is not None]
        weights = [one.share**-2 for one in known]
        mean_m = sum(w * one.height_m for w, one in zip(weights, known, strict=True)) / sum(weights) if known else 0.0
        self._best = HeightMeasurement(mean_m, math.hypot(LEAST_MAP_SHARE, sum(weights) ** -0.5)) if known else None

    def drive(self, heights_per_s: float, now_ns: int) -> None:
        """It moves ahead so fast now, in heights a second; `compare` follows where GPS measures it as well."""
        self._has_gps = False
        self._places.drive(heights_per_s, now_ns)

    def compare(self, gps_m: float, heights: float, mount_rad: tuple[float, float], now_ns: int) -> None:
        """A step was so many meters long by GPS, and so many heights by the camera. mount_rad: its pitch and yaw."""
        self._has_gps = True
        pitch_rad, yaw_rad = mount_rad
        self._window += gps_m, heights, gps_m * yaw_rad
        meters, driven, yaws = self._window.tolist()
        if meters < WINDOW_M:
            return
        window_m, found_rad, self._window = meters / max(driven, 1e-9), yaws / meters, np.zeros(3)
        self._windows_m = _newest(self._windows_m, window_m)
        self._places.begin()  # they tell whether it still holds from here on
        self._combine()
        heights_m = _newest(self.kept.heights_m, window_m)
        self.pitch_rad += (pitch_rad - self.pitch_rad) / len(heights_m)
        before_rad = found_rad if self.yaw_rad is None else self.yaw_rad
        self.yaw_rad = before_rad + (found_rad - before_rad) / len(heights_m)
        self.kept = HeightRecord(self.kept.camera, self.pitch_rad, heights_m, self.yaw_rad)
        if len(heights_m) >= WINDOWS and now_ns - self._saved_ns >= SAVED_NS:
            self._saved_ns = now_ns
            self._file.write_behind(self.kept)

    def use_frame(self, line: SequencePosition | None) -> None:
        """A frame that lines may lead through; line: that of its match, None where none is believed."""
        self._places.use_frame(line)
        self._combine()


class _ByPlaces:
    """Lines along one drive of the map, one after another: a straight line through meters against heights driven."""

    def __init__(self, frames: int) -> None:
        self._driven, self._rate = 0.0, (0.0, 0)  # ahead in heights; a second, and when
        self._frames: deque[float] = deque(maxlen=frames)
        self.begin()

    def begin(self) -> None:
        """Only what lies ahead counts."""
        self._since, self._drive, self._first = self._driven, "", 0.0
        self._last = 0.0, 0.0
        self._sums = np.zeros(5)  # of 1, x, y, x x and x y

    def drive(self, heights_per_s: float, now_ns: int) -> None:
        """It moves ahead so fast now."""
        (before_per_s, before_ns), self._rate = self._rate, (heights_per_s, now_ns)
        if now_ns - before_ns > SPANNED_NS:
            self._frames.clear()
            self.begin()
        else:
            self._driven += (before_per_s + heights_per_s) / 2 * (now_ns - before_ns) / 1e9

    def use_frame(self, line: SequencePosition | None) -> None:
        """A frame that lines may lead through was exposed here."""
        self._frames.append(self._driven)
        at = -1.0 if line is None else len(self._frames) - 1 - line.back
        heights = float(np.interp(at, range(len(self._frames)), self._frames))
        if line is None or at < 0 or heights < self._since:
            return
        on, on_m = heights - self._last[0], line.along_m - self._last[1]
        known = self.measured
        off_m = 0.0 if known is None else abs(on_m - on * known.height_m)
        if line.drive != self._drive or off_m > 2 * MATCH_M + STRETCHED * abs(on_m):
            self.begin()
            self._since, self._drive, self._first = heights, line.drive, line.along_m
        self._last = heights, line.along_m
        x, y = heights - self._since, line.along_m - self._first
        kept = math.exp(-abs(on_m) / FORGOTTEN_M) if self._sums[0] else 0.0
        self._sums = kept * self._sums + (1, x, y, x * x, x * y)

    @property
    def measured(self) -> HeightMeasurement | None:
        """The slope, with as many independent lines as there are stretches of LINES_M; None where it says nothing."""
        count, x, y, xx, xy = self._sums
        spread = xx / count - (x / count) ** 2 if count else 0.0
        height_m = (xy / count - x * y / count**2) / spread if spread > 0 else 0.0
        if not height_m > 0:
            return None
        apart_m = height_m * math.sqrt(spread)
        share = MATCH_M / (apart_m * math.sqrt(1 + math.sqrt(12) * apart_m / LINES_M))
        return HeightMeasurement(float(height_m), math.hypot(share, MAP_SHARE)) if share < 1 else None


def kept_height(path: Path | None) -> PersistentFile[HeightRecord]:
    """What is kept beside the journal at `path`."""
    return PersistentFile(path, HeightRecord, "the camera's height is learned again")


def read_height(path: Path | None, camera: str, pitch_rad: float) -> HeightRecord:
    """What is kept for this camera; else nothing, with the pitch of its configuration."""
    kept = kept_height(path).read()
    is_known = kept and kept.camera == camera and all(height_m > 0 for height_m in kept.heights_m)
    return kept if kept and is_known else HeightRecord(camera, pitch_rad)


def _newest(windows_m: tuple[float, ...], window_m: float) -> tuple[float, ...]:
    """With one more, those since the mount last slipped."""
    windows_m = (*windows_m, window_m)[-WINDOWS_MOST:]
    off = np.abs(np.array(windows_m[-WINDOWS:]) / np.median(windows_m) - 1)
    return windows_m[-WINDOWS:] if off.min() > SLIPPED else windows_m


def _by_windows(heights_m: tuple[float, ...]) -> HeightMeasurement | None:
    """The median, and its error by the median distance from it: 1.48 and 1.25 are those of normal errors."""
    if not heights_m:
        return None
    middle_m = float(np.median(heights_m))
    spread = 1.48 * float(np.median(np.abs(np.array(heights_m) - middle_m))) / middle_m
    return HeightMeasurement(middle_m, 1.25 * max(WINDOW_SHARE, spread) / math.sqrt(len(heights_m)))
