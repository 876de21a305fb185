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


def read_anchors(file: Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Frames and their meters along the route, (A,) each, of anchors.csv; FeedError names the line.

    At least two anchors, frames in ascending order.
    """
    records = read_records(file, ("frame", "route_m"), "it gives the places marked by hand, as lines frame,route_m")
    for before, record in pairwise(records):
        if record.integer("frame") <= before.integer("frame"):
            raise FeedError(f"{record.where}: frame {record.integer('frame')} is not after the line before")
    if len(records) < 2:
        raise FeedError(f"{file}: one anchor, and two at least are needed")
    anchors = np.array([(record.integer("frame"), record.number("route_m")) for record in records])
    return anchors[:, 0], anchors[:, 1]


def open_traverse(path: Path, options: ReadOptions) -> Traverse:
    """The frames of a folder or a video; `positions` names another file of anchors. FeedError names what is wrong."""
    names, stamps_ns, pictures = frames_of(path, options.fps or NOMINAL_FPS)
    beside = path.with_suffix(".csv") if path.suffix.lower() in VIDEO_SUFFIXES else path / "anchors.csv"
    file = Path(options.positions) if options.positions else beside
    anchors, anchors_m = read_anchors(file)
    for frame in anchors[[0, -1]]:
        if not 0 <= frame < len(names):
            raise FeedError(f"{file}: frame {frame:g} is not among the {len(names)} frames of {path}")
    covered_m = np.r_[0.0, np.abs(np.diff(anchors_m)).cumsum()]  # whichever way it goes
    rows = []
    for index, (name, stamp_ns) in enumerate(zip(names, stamps_ns, strict=True)):
        if anchors[0] <= index <= anchors[-1]:
            route_m, distance_m = (float(np.interp(index, anchors, meters)) for meters in (anchors_m, covered_m))
            rows.append(FeedRow(name, stamp_ns, distance_m=distance_m, extra={"route_m": f"{route_m:.3f}"}))
        else:
            rows.append(FeedRow(name, stamp_ns))
    return Traverse(
        name=path.stem,
        source=f"{path.name}, {len(anchors)} anchors",
        rows=tuple(rows),
        pictures=pictures,
        notes="route_m and distance_m are interpolated between places marked by hand",
    )
