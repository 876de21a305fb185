"""Which recordings of a road were where the others were not: one that was shifted, or whose GPS was spoofed.

Pictures say which drives disagree. Which of two is wrong, drives say that looked another way as well: where one of the
two leads beside the way that such a drive went, and the other along it, that is a vote against the first. A shift along
a straight road moves no drive off its way, and gets no such vote.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.geodesy import east_north, first_known
from edge.map_agreement import EXPLAINED_SIGMAS, ONE_VIEW, SEARCHED_M, STEP, Disagreement
from edge.reference_map import MapSet, sigmas_m

ALIGNED = 0.5
"""Cosine of 60 degrees between the courses of two drives of one way, see `edge_plugins.layers`."""
Pair = tuple[Path, Path]


class _Way(NamedTuple):
    """Places of a drive: meters (N, 2), unit vectors (N, 2) of travel, and standard deviations (N,)."""

    at_m: NDArray[np.float64]
    course: NDArray[np.float64]
    sigma_m: NDArray[np.float64]

    def part(self, rows: slice | NDArray[np.intp]) -> _Way:
        """Some of the places."""
        return _Way(*(values[rows] for values in self))


def outvoted(maps: MapSet, found: Sequence[Disagreement]) -> dict[Path, float]:
    """Maps whose positions are not those of two or more others that do not disagree with each other: by how much.

    One after another, that of most votes against it; where none has more than those that it disagrees with, nobody
    knows which is wrong. Maps of one recording are one.
    """
    apart_m: dict[Pair, float] = {}
    for one in found:
        (first, *_), (second, *_) = one.stretches
        for pair in ((first, second), (second, first)):
            apart_m[pair] = max(one.apart_m, apart_m.get(pair, 0.0))
    recordings = {one.path: frozenset(segment.source for segment in one.header.segments) for one in maps.maps}
    beside: defaultdict[Pair, set[frozenset[str]]] = defaultdict(set)
    for pair, third in _beside(maps, found):
        if recordings[third] not in (recordings[pair[0]], recordings[pair[1]]):
            beside[pair].add(recordings[third])

    def against(path: Path) -> set[Path]:
        return {other for one, other in apart_m if one == path and recordings[one] != recordings[other]}

    def votes(path: Path) -> int:
        others = against(path)
        return len({recordings[other] for other in others}.union(*(beside[path, other] for other in others)))

    wrong: dict[Path, float] = {}
    while apart_m:
        most = max((path for path, _ in apart_m), key=lambda path: (votes(path), path.name))
        if votes(most) < 2 or votes(most) <= max(votes(other) for other in against(most)):
            break
        wrong[most] = max(far_m for (one, _), far_m in apart_m.items() if one == most)
        apart_m = {pair: far_m for pair, far_m in apart_m.items() if most not in pair}
    return wrong


def _beside(maps: MapSet, found: Sequence[Disagreement]) -> Iterator[tuple[Pair, Path]]:
    """Of two drives that disagree, the one that leads beside the way of a third, and the other one; and the third."""
    places = maps.places
    origin = first_known(places["lat_deg"], places["lon_deg"])
    if origin is None:
        return
    ground = _Way(east_north(places["lat_deg"], places["lon_deg"], origin), _courses(maps), sigmas_m(places))
    starts = dict(zip((one.path for one in maps.maps), maps.index.starts, strict=False))
    for one in found:
        ways = [ground.part(slice(starts[path] + a, starts[path] + b, STEP // 2)) for path, a, b in one.stretches]
        for number, third in enumerate(maps.maps):
            along = ground.part(slice(*maps.index.rows[number]))
            is_beside = [_leads_beside(way, along) for way in ways]
            (first, *_), (second, *_) = one.stretches
            if is_beside in ([True, False], [False, True]):
                yield ((first, second) if is_beside[0] else (second, first)), third.path


def _leads_beside(way: _Way, along: _Way) -> bool | None:
    """Whether a stretch is further from the way that a drive went than accuracy and lanes explain; None: not near."""
    off_m = np.hypot(*(way.at_m[:, np.newaxis] - along.at_m).transpose(2, 0, 1))
    off_m[~(way.course @ along.course.T >= ALIGNED)] = np.inf
    nearest = np.where(np.isnan(off_m), np.inf, off_m).argmin(axis=1)
    apart_m = float(np.median(off_m[np.arange(len(nearest)), nearest]))
    if not apart_m < SEARCHED_M:
        return None
    sigma_m = np.hypot(np.median(way.sigma_m), np.median(along.sigma_m[nearest]))
    return apart_m > ONE_VIEW.explained_m + EXPLAINED_SIGMAS * float(sigma_m)


def _courses(maps: MapSet) -> NDArray[np.float64]:
    heading_rad = np.radians(maps.places["heading_deg"].astype(np.float64))
    return np.stack([np.sin(heading_rad), np.cos(heading_rad)], axis=1)
