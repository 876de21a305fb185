"""What to expect of a route: for each stretch, and the longest gap of a whole drive.

Where real drives passed, what they found is what to expect; of the whole route, rehearsed drives count as few.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from edge.reference_map import Drives, MapSet
from sim.coverage.aliases import SegmentSpan
from sim.coverage.passes import SPARE_M, Pass, road_between_m

SOON_M = 100.0
KNOWN_M = 200.0
"""From where a drive enters a segment: beyond, predicted and found shares of stretches correlate -0.04 to 0.42
(docs/mapping.md), so the mean of all such stretches predicts each as well, and no differences are shown."""
REHEARSED_COUNT_AS = 2.0
"""Real drives that all rehearsed ones count as."""


@dataclass(frozen=True)
class SheetSpan:
    """share: of its frames that will be believed. soon: probability of a believed frame within SOON_M of entering it.

    Both None where nothing is known. drives, believed_in: real drives that passed, and had a believed frame there.
    """

    span: SegmentSpan
    share: float | None
    soon: float | None
    drives: int
    believed_in: int
    is_mean: bool = False
    """Whether share and soon are the mean of all stretches far from where drives enter: of each, no more is known."""


@dataclass(frozen=True)
class Gap:
    """Meters of driving without a believed frame, and where on the map they end: meters [from_m, to_m] of a segment."""

    length_m: float
    segment: int
    from_m: float
    to_m: float


@dataclass(frozen=True)
class Sheet:
    """stretches: of all segments. gap: the longest one of a typical drive, None where most drives
    passed the map without a believed frame.

    completed: share of the drives on which the drift stays within a limit everywhere.
    """

    stretches: tuple[SheetSpan, ...]
    gap: Gap | None
    completed: float

    @classmethod
    def of(
        cls,
        maps: MapSet,
        drives: Drives,
        spans: Sequence[SegmentSpan],
        rehearsed: Sequence[Sequence[Pass]],
        driven: Sequence[Sequence[Pass]],
        longest_m: float,
    ) -> Sheet:
        """Of rehearsed drives and real ones. longest_m: gap in which the drift reaches its limit."""
        weights = [REHEARSED_COUNT_AS / max(len(rehearsed), 1)] * len(rehearsed) + [1.0] * len(driven)
        both = [*rehearsed, *driven]
        gaps = [longest_gap(one, maps) for one in both]
        weighted = list(zip(gaps, weights, strict=True))
        short = sum(weight for gap, weight in weighted if gap is not None and gap.length_m <= longest_m)
        stretches = tuple(_stretch(span, both, weights, len(rehearsed)) for span in spans)
        stretches = _pooled(stretches, rehearsed)
        return cls(stretches, _typical(weighted), short / max(sum(weights), SPARE_M))


def _pooled(stretches: Sequence[SheetSpan], rehearsed: Sequence[Sequence[Pass]]) -> tuple[SheetSpan, ...]:
    """With the mean of all stretches far from where drives enter, in each of these that nobody has driven."""
    entries: dict[int, list[float]] = {}
    for one in chain.from_iterable(rehearsed):
        entries.setdefault(one.segment, []).extend(one.along_m[:1].tolist())
    entered_m = {segment: float(np.median(at_m)) for segment, at_m in entries.items() if at_m}

    def is_far(one: SheetSpan) -> bool:
        at_m = entered_m.get(one.span.segment)
        near_m = math.inf if at_m is None else min(abs(one.span.from_m - at_m), abs(one.span.to_m - at_m))
        return near_m >= KNOWN_M and not one.drives and one.share is not None

    far = [one for one in stretches if is_far(one)]
    if not far:
        return tuple(stretches)
    share, soon = (float(np.mean(values)) for values in zip(*((one.share, one.soon) for one in far), strict=True))
    return tuple(replace(one, share=share, soon=soon, is_mean=True) if one in far else one for one in stretches)


def spans_of(maps: MapSet, drives: Drives, length_m: float) -> list[SegmentSpan]:
    """The stretches of all segments, of one length but for the last of each."""
    found = []
    for segment in range(len(maps.index.segments)):
        low_m, high_m = drives.extent_m(segment)
        for from_m in np.arange(low_m, max(high_m, low_m + SPARE_M), length_m):
            found.append(SegmentSpan(segment, float(from_m), float(min(from_m + length_m, high_m + SPARE_M))))
    return found


def longest_gap(one_drive: Sequence[Pass], maps: MapSet) -> Gap | None:
    """Of one drive, over the unmapped roads between its segments as well, where their length is known."""
    longest: Gap | None = None
    since_m, before = 0.0, -1
    for one in one_drive:
        if not one.along_m.size:
            continue
        road_m = road_between_m(maps, before, one.segment) if before >= 0 else 0.0
        since_m, before = since_m + road_m if math.isfinite(road_m) else 0.0, one.segment
        from_m = float(one.along_m[0])
        ends_m = float(one.along_m[-1])
        for to_m in [*one.along_m[one.believed].tolist(), ends_m]:
            length_m = since_m + abs(to_m - from_m)
            if longest is None or length_m > longest.length_m:
                longest = Gap(length_m, one.segment, min(from_m, to_m), max(from_m, to_m))
            if to_m != ends_m or one.believed[-1]:
                since_m, from_m = 0.0, to_m
        since_m += abs(ends_m - from_m)
    return longest


def _typical(gaps: Sequence[tuple[Gap | None, float]]) -> Gap | None:
    """The weighted median by length; None where most drives have no believed frame."""
    ordered = sorted(gaps, key=lambda item: math.inf if item[0] is None else item[0].length_m)
    if not ordered:
        return None
    at = np.searchsorted(np.cumsum([weight for _, weight in ordered]), sum(weight for _, weight in ordered) / 2)
    return ordered[min(int(at), len(ordered) - 1)][0]


def _stretch(span: SegmentSpan, both: Sequence[Sequence[Pass]], weights: Sequence[float], rehearsed: int) -> SheetSpan:
    frames = believed = passed = soon = 0.0
    real, believed_in = 0, 0
    was_driven = any(one.is_inside(span.segment, span.from_m, span.to_m) for one in chain(*both[rehearsed:]))
    for number, (one_drive, weight) in enumerate(zip(both, weights, strict=True)):
        if was_driven and number < rehearsed:
            continue
        there = [one for one in one_drive if one.segment == span.segment]
        inside = [one.believed[(one.along_m >= span.from_m) & (one.along_m < span.to_m)] for one in there]
        of_drive = np.concatenate(inside) if inside else np.zeros(0, dtype=bool)
        if not of_drive.size:
            continue
        frames, believed = frames + weight, believed + weight * float(of_drive.mean())
        until_m = [one.until_believed_m(span.from_m, span.to_m) for one in there]
        passed, soon = passed + weight, soon + weight * (np.nanmin(until_m) <= SOON_M)
        if number >= rehearsed:
            real, believed_in = real + 1, believed_in + bool(of_drive.any())
    return SheetSpan(
        span, believed / frames if frames else None, float(soon / passed) if passed else None, real, believed_in
    )
