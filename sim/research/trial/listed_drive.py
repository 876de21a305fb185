"""A drive from the field as a row of `lookback dev flights`: its list, through the position estimator of today.

What there was of GPS is its truth: a position is judged where GPS had the vehicle at its moment, and only counted where
there was none. Autopilot and pictures are not replayed: what was recognized stays as it was.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from edge.config import Config
from edge.geodesy import east_north_of
from edge.journal.records import PlaceFix
from edge.localization import AutopilotState, Fix, MapUpdate
from edge.localization.drive_file import read_drive, replay
from edge.localization.events import ImageProcessed
from edge.localization.place_fix import untracked_fix
from edge.localization.position_estimator import Entry, FixResult
from edge.reference_map import Route
from edge.telemetry.encoders import EXTERNAL_POSITION_ESTIMATE
from edge.telemetry.position_sender import level_m
from edge.telemetry.shadow import Shadow
from sim.bundle import drive_list
from sim.research.trial.flight_score import Score, SentPosition, position_of, scored
from sim.trial.records import Array

APART_S = 1.0
"""Between two frames at which GPS was known, for what lies between them."""
Entries = Sequence[tuple[int, Entry]]


class ListedDrive:
    """then, now: positions as recorded, and by the estimator of today. lost_m: driven since GPS was lost, or in all."""

    def __init__(self, file: Path) -> None:
        """file: the list of a drive, or what `lookback bundle` made. FeedError for what is neither."""
        with TemporaryDirectory() as folder:
            self.config, entries = read_drive(drive_list(file, Path(folder)))
        own = [(t_ns, one) for t_ns, one in entries if isinstance(one, AutopilotState)]
        healthy = next((row for row, (_, one) in enumerate(own) if one.gps == "healthy"), len(own))
        first = next((row for row in range(healthy, len(own)) if own[row][1].gps == "not healthy"), 0)
        self._begins_ns = own[first][0] if own else 0
        self._ends_ns = entries[-1][0] if entries else 0
        known_m = [(t_ns / 1e9, one.driven_m) for t_ns, one in own[first:] if one.driven_m is not None]
        self._driven_m: Array = np.array(known_m).reshape(-1, 2)
        self._gps = [(one.stamp_ns / 1e9, one.gps) for _, one in entries if isinstance(one, ImageProcessed) and one.gps]
        self.lost_m = float(np.ptp(self._driven_m[:, 1])) if known_m else 0.0
        asked = [one for _, one in entries if isinstance(one, FixResult)]
        frames = _frames(self.config, entries)
        self.then = self._score([fix for one in asked if (fix := position_of(one.answer))], frames)
        self.now = self._score(_fixes(self.config, entries, was_asked=bool(asked)), frames)

    def _score(self, fixes: Sequence[Fix], frames: Sequence[PlaceFix | None]) -> Score:
        """Of each exposure the first position."""
        first: dict[int, Fix] = {}
        for fix in fixes:
            first.setdefault(fix.place.stamp_ns, fix)
        positions = [self._position(fix) for fix in first.values()]
        ends_s = (self._ends_ns - self._begins_ns) / 1e9
        moments_s = [0.0, *sorted(one.time_s for one in positions if 0 <= one.time_s <= ends_s), ends_s]
        off_m = [self._off_m(one)[0] for one in frames if one is not None]
        return scored(positions, moments_s, len(frames), off_m, [])

    def _position(self, fix: Fix) -> SentPosition:
        since_s, at_s = (fix.place.stamp_ns - self._begins_ns) / 1e9, fix.place.stamp_ns / 1e9
        driven_m = float(np.interp(at_s, *self._driven_m.T) - self._driven_m[0, 1]) if len(self._driven_m) else 0.0
        error_m, along_m, cross_track_m = (round(one, 3) for one in self._off_m(fix.place))
        of_place = error_m, along_m, cross_track_m, fix.place.sigma_m
        at = round(since_s, 3), driven_m, EXTERNAL_POSITION_ESTIMATE
        return SentPosition(*at, *of_place, *level_m(fix.level), fix.place.sigma_along_m)

    def _off_m(self, place: PlaceFix) -> tuple[float, float, float]:
        """From where GPS had the vehicle then: in all, ahead, and to the right; NaN where it did not."""
        at_s = place.stamp_ns / 1e9
        row = int(np.searchsorted([time_s for time_s, _ in self._gps], at_s))
        around = [one for one in self._gps[max(row - 1, 0) : row + 1] if abs(one[0] - at_s) <= APART_S]
        if not around or place.lat_deg is None or place.lon_deg is None:
            return math.nan, math.nan, math.nan
        times_s, fixes = zip(*around, strict=True)
        off_m = [east_north_of(place.lat_deg, place.lon_deg, (one.lat_deg, one.lon_deg)) for one in fixes]
        east_m, north_m = (float(np.interp(at_s, times_s, [one[axis] for one in off_m])) for axis in range(2))
        sin, cos = math.sin(math.radians(place.heading_deg or 0.0)), math.cos(math.radians(place.heading_deg or 0.0))
        return math.hypot(east_m, north_m), east_m * sin + north_m * cos, east_m * cos - north_m * sin


def _frames(config: Config, entries: Entries) -> list[PlaceFix | None]:
    """Where each frame was recognized, None where it was not."""
    found: list[PlaceFix | None] = []
    route: Route | None = None
    for _, one in entries:
        if isinstance(one, MapUpdate):
            route = Route(one.map_set)
        elif isinstance(one, ImageProcessed):
            match = one.match if one.match is not None and one.match.accepted else None
            found.append(untracked_fix(match, one.stamp_ns, route, config.rig) if match and route else None)
    return found


def _fixes(config: Config, entries: Entries, *, was_asked: bool) -> list[Fix]:
    """The positions of today's estimator: when it was asked, or after each frame without GPS where it never was."""
    if was_asked:
        return [fix for _, _, now in replay(config, list(entries)) if (fix := position_of(now))]
    found, shadow = [], Shadow(config, lambda record: None)
    for t_ns, one in entries:
        shadow.update(t_ns, one)
        if isinstance(one, ImageProcessed) and isinstance(answer := shadow.fix(t_ns), Fix):
            found.append(answer)
    return found
