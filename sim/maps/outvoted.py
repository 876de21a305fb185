"""Which recordings of a road were where the others were not: one that was shifted, or whose GPS was spoofed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from edge.map_agreement import Disagreement
from edge.reference_map import MapSet


def outvoted(maps: MapSet, found: Sequence[Disagreement]) -> dict[Path, float]:
    """Maps whose positions disagree with those of two or more others that do not disagree with each other: by how much.

    One after another, that of most disagreements; where no map has more than those that it disagrees with, nobody knows
    which is wrong. Maps of one recording are one.
    """
    apart_m: dict[tuple[Path, Path], float] = {}
    for one in found:
        (first, *_), (second, *_) = one.stretches
        for pair in ((first, second), (second, first)):
            apart_m[pair] = max(one.apart_m, apart_m.get(pair, 0.0))
    recordings = {one.path: frozenset(segment.source for segment in one.header.segments) for one in maps.maps}

    def against(path: Path) -> set[Path]:
        return {other for one, other in apart_m if one == path and recordings[one] != recordings[other]}

    def votes(path: Path) -> int:
        return len({recordings[other] for other in against(path)})

    wrong: dict[Path, float] = {}
    while apart_m:
        most = max((path for path, _ in apart_m), key=lambda path: (votes(path), path.name))
        if votes(most) < 2 or votes(most) <= max(votes(other) for other in against(most)):
            break
        wrong[most] = max(far_m for (one, _), far_m in apart_m.items() if one == most)
        apart_m = {pair: far_m for pair, far_m in apart_m.items() if most not in pair}
    return wrong
