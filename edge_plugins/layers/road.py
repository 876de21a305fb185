"""Which drives of a folder of maps pass the same road, and which way they faced there.

A stretch is a place of the road and the way along which a camera faced there, within 60 degrees. It has a layer for
each drive that saw it, so a rear camera on the way out and a front camera on the way home are layers of the same
stretches.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.geodesy import east_north, first_known
from edge.reference_map import ReferenceMap

STRETCH_M = 25.0
"""Drives whose places are so near pass one stretch: both lanes (12 m) and GPS between houses (5 m) twice."""
NEEDED = 4
"""Stretches, each about STRETCH_M long: together the shortest sequence that is recognized (40 places, 80 m)."""
ALIGNED = 0.5
"""Cosine of 60 degrees, between two views: bends within STRETCH_M, and no crossing road."""
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class LayerRows:
    """rows: of each layer, by number of the drive, the row closest to it. opposed: of drives that faced against it."""

    rows: dict[int, int]
    opposed: dict[int, int]

    @property
    def drives(self) -> set[int]:
        """That pass here, whichever way they faced."""
        return {*self.rows, *self.opposed}


def stretches(maps: Sequence[ReferenceMap], every: int = 1) -> list[LayerRows]:
    """Of all drives with positions, in both views, even where one has no layer. every: step of rows."""
    places = [one.places for one in maps]
    known = (first_known(one["lat_deg"], one["lon_deg"]) for one in places)
    origin = next((one for one in known if one is not None), None)
    if origin is None:
        return []
    ground = [east_north(one["lat_deg"], one["lon_deg"], origin) for one in places]
    views = [_views_of(one, at_m) for one, at_m in zip(maps, ground, strict=True)]
    centers = _centers(ground, views, every)
    rows: list[tuple[dict[int, int], dict[int, int]]] = [({}, {}) for _ in centers.points]
    for number, (at_m, view) in enumerate(zip(ground, views, strict=True)):
        nearest: dict[tuple[int, bool], float] = {}
        for row in _known(at_m, view, every):
            for center, apart_m, cosine in centers.near(at_m[row], view[row]):
                key = center, cosine > 0
                if apart_m < nearest.get(key, math.inf):
                    nearest[key] = apart_m
                    rows[center][cosine > 0][number] = row
    found = []
    for ways in rows:
        found += [LayerRows(*ways), LayerRows(*ways[::-1])]
    return found


class _Centers:
    """Middles of stretches: a point and an axis each, in cells of STRETCH_M."""

    def __init__(self) -> None:
        self.points: list[tuple[float, float, float, float]] = []
        self._cells: defaultdict[tuple[int, int], list[int]] = defaultdict(list)

    def near(self, at_m: Floats, view: Floats) -> Iterator[tuple[int, float, float]]:
        """Those within STRETCH_M of a point along whose axis it faces: number, meters, cosine."""
        (x, y), (east, north) = at_m.tolist(), view.tolist()
        column, line = math.floor(x / STRETCH_M), math.floor(y / STRETCH_M)
        for cell in ((column + i, line + j) for i in (-1, 0, 1) for j in (-1, 0, 1)):
            for number in self._cells.get(cell, ()):
                cx, cy, axis_east, axis_north = self.points[number]
                apart_m, cosine = math.hypot(x - cx, y - cy), east * axis_east + north * axis_north
                if apart_m <= STRETCH_M and abs(cosine) >= ALIGNED:
                    yield number, apart_m, cosine

    def add(self, at_m: Floats, view: Floats) -> None:
        """One more."""
        (x, y), (east, north) = at_m.tolist(), view.tolist()
        self._cells[math.floor(x / STRETCH_M), math.floor(y / STRETCH_M)].append(len(self.points))
        self.points.append((x, y, east, north))


def _centers(ground: Sequence[Floats], views: Sequence[Floats], every: int) -> _Centers:
    centers = _Centers()
    for at_m, view in zip(ground, views, strict=True):
        for row in _known(at_m, view, every):
            if next(centers.near(at_m[row], view[row]), None) is None:
                centers.add(at_m[row], view[row])
    return centers


def _known(at_m: Floats, view: Floats, every: int) -> list[int]:
    rows: list[int] = np.flatnonzero(np.isfinite(at_m[:, 0]) & np.isfinite(view[:, 0]))[::every].tolist()
    return rows


def _views_of(one: ReferenceMap, at_m: Floats) -> Floats:
    """Unit vectors (N, 2) along which the camera faced, east and north: by the heading, else by the places around."""
    heading = np.radians(one.places["heading_deg"])
    view = np.stack([np.sin(heading), np.cos(heading)], axis=1)
    for segment in one.header.segments:
        rows = slice(segment.start, segment.end)
        if segment.end - segment.start >= 2:
            ahead = np.gradient(at_m[rows], axis=0)
            with np.errstate(invalid="ignore", divide="ignore"):
                ahead /= np.hypot(ahead[:, :1], ahead[:, 1:])
            view[rows] = np.where(np.isnan(view[rows]), ahead, view[rows])
        if segment.view == "rear":
            view[rows] *= -1
    return view
