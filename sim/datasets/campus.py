"""University Campus style: frames, and a few places marked by hand.

    forward_day/00001.jpg ... (or forward_day.mp4)
    forward_day/anchors.csv (or forward_day.csv)     frame,route_m

The paper (section IV-B) marked 20 places by hand in each traverse and interpolated between them; it published no
layout for them. Here a line of `anchors.csv` says that frame `frame` (counted from 0 in the order of the names) is
`route_m` meters along the route, which all traverses share; one that goes the other way has falling meters. Where
nobody measured the route, give the frame of the reference traverse in place of meters: tolerances are then frames.

Frames before the first and after the last anchor have no place.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edge.errors import FeedError
from edge.feed import FeedRow
from sim.datasets import ReadOptions, Traverse
from sim.datasets.pictures import VIDEO_SUFFIXES, frames_of
from sim.datasets.tables import read_records

NOMINAL_FPS = 1.0


@dataclass(frozen=True)
class Anchors:
    """Frames whose place along the route is known: (A,) each; frames ascend."""

    frame: NDArray[np.float64]
    route_m: NDArray[np.float64]

    def route_at(self, count: int) -> NDArray[np.float64]:
        """(count,) meters along the route of each frame, linear between anchors, NaN outside them."""
        return self._between(self.route_m, count)

    def distance_at(self, count: int) -> NDArray[np.float64]:
        """(count,) meters covered since the first anchor, whichever way it goes."""
        covered_m = np.concatenate([[0.0], np.abs(np.diff(self.route_m)).cumsum()])
        return self._between(covered_m, count)

    def _between(self, meters: NDArray[np.float64], count: int) -> NDArray[np.float64]:
        return np.asarray(np.interp(np.arange(count), self.frame, meters, left=np.nan, right=np.nan))


def read_anchors(file: Path) -> Anchors:
    """Read anchors.csv; FeedError names the line. At least two anchors, frames in ascending order."""
    records = read_records(file, ("frame", "route_m"), "it gives the places marked by hand, as lines frame,route_m")
    for before, record in pairwise(records):
        if record.integer("frame") <= before.integer("frame"):
            raise FeedError(f"{record.where}: frame {record.integer('frame')} is not after the line before")
    if len(records) < 2:
        raise FeedError(f"{file}: one anchor, and two at least are needed")
    return Anchors(
        np.array([record.integer("frame") for record in records], dtype=np.float64),
        np.array([record.number("route_m") for record in records]),
    )


def open_traverse(path: Path, options: ReadOptions) -> Traverse:
    """The frames of a folder or a video; `positions` names another file of anchors. FeedError names what is wrong."""
    names, stamps_ns, pictures = frames_of(path, options.fps or NOMINAL_FPS)
    beside = path.with_suffix(".csv") if path.suffix.lower() in VIDEO_SUFFIXES else path / "anchors.csv"
    file = Path(options.positions) if options.positions else beside
    anchors = read_anchors(file)
    for frame in anchors.frame[[0, -1]]:
        if not 0 <= frame < len(names):
            raise FeedError(f"{file}: frame {frame:g} is not among the {len(names)} frames of {path}")
    route_m, distance_m = anchors.route_at(len(names)), anchors.distance_at(len(names))
    rows = []
    for index, (name, stamp_ns) in enumerate(zip(names, stamps_ns, strict=True)):
        known = not np.isnan(route_m[index])
        extra = {"route_m": f"{route_m[index]:.3f}"} if known else {}
        rows.append(FeedRow(name, stamp_ns, distance_m=float(distance_m[index]) if known else None, extra=extra))
    return Traverse(
        name=path.stem,
        view=options.view or "front",
        source=f"{path.name}, {len(anchors.frame)} anchors",
        rows=tuple(rows),
        pictures=pictures,
        notes="route_m and distance_m are interpolated between places marked by hand",
    )
