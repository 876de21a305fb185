"""Where the layers of a road are, by each other: those with GPS by what their receivers say, those without by these.

A drive with GPS is moved to the median of what the drives say that looked the same way there, each weighted by its
stated accuracy: one of them that is wrong moves a median little, however far it is off. It stays as uncertain as its
own receiver was, and neither of two drives that disagree moves the other. A drive without GPS is driven over the
others, as by a vehicle, and lies where the middles of its lines are. It moves no other drive.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from edge.config import Config
from edge.geodesy import all_moved
from edge.localization.place_fix import LineMiddle, line_middle
from edge.map_agreement import Compared, Disagreement
from edge.reference_map import MapSet, ReferenceMap, Route, sigmas_m
from edge.reference_map.learned import with_positions
from edge.reference_map.store import Segment
from edge.sequence import Travel
from edge.sequence_matcher import SequenceMatcher
from sim.traverse import config_as_mapped

Floats = NDArray[np.float64]
LANES_M = 1.5
"""Standard deviation of where two drives of one way are beside each other, and of a line: half of what `map_agreement`
explains by these."""
SMOOTHED = 3
"""Windows in a row whose median counts: one of them may show another place, see `map_agreement.WINDOWS`."""
HOLDS_M, ENDS_M = 60.0, 120.0
"""A window speaks for so many meters of the drive, and beyond ever less, up to so many: windows are 40 m apart."""
DRIFT = 0.05
"""Share by which a place beyond the middle of a line may be elsewhere along the road: an odometer's scale."""
LINES = 4
"""Lines before and after one whose median counts, 16 m: neighbors share most of their frames, and differ by 1.5 m."""
WITHIN_M = 40.0
"""Meters from the middle of a line up to which a place is known by it: half of the shortest line, 40 places."""

APART_M = 1e7
"""Between the segments of a drive, so that none of the lengths above reaches from one into the next."""


@dataclass(frozen=True)
class Placed:
    """Newer positions of a drive: degrees and standard deviation (3, N). recording: by which, if not its own."""

    rows: Floats
    recording: str = ""


def newer_positions(
    maps: MapSet,
    windows: Sequence[Compared],
    disagree: Sequence[Disagreement],
    wrong: AbstractSet[int],
    changed: AbstractSet[int],
) -> dict[int, Placed]:
    """By number of the map, of those that may be `changed`; wrong: those by whose positions no other is moved."""
    of_path = {one.path: number for number, one in enumerate(maps.maps)}
    against = {frozenset(of_path[path] for path, _, _ in one.stretches) for one in disagree}
    changed = {number for number in changed if maps.maps[number].header.tile is None}
    agreed = [one for one in windows if one.is_one_view and not _between(maps, one) & wrong]
    agreed = [one for one in agreed if frozenset(_between(maps, one)) not in against]
    found = {number: one for number, one in weighted(maps, agreed).items() if number in changed}
    with_gps = [number for number, one in enumerate(maps.maps) if not np.isnan(one.places["lat_deg"]).all()]
    now = moved(maps, found).maps
    right = [now[number] for number in with_gps if number not in wrong]
    if right:
        there = MapSet.of(right, maps.path)
        for number in sorted(changed.difference(with_gps)):
            one = placed(maps.maps[number], there)
            found.update({number: one} if one is not None else {})
    return found


def moved(maps: MapSet, newer: Mapping[int, Placed]) -> MapSet:
    """Maps at newer positions, by number."""
    several = [
        with_positions(one, newer[number].rows) if number in newer else one for number, one in enumerate(maps.maps)
    ]
    return MapSet.of(several, maps.path)


def _between(maps: MapSet, window: Compared) -> set[int]:
    """The maps that a window compares."""
    return {maps.index.map_of(place) for place in window.places}


def weighted(maps: MapSet, windows: Sequence[Compared]) -> dict[int, Placed]:
    """Drives of recordings of which no two disagree in these windows, by number of the map."""
    said: defaultdict[int, defaultdict[str, list[tuple[int, int, Floats]]]]
    said = defaultdict(lambda: defaultdict(list))
    for one in windows:
        recordings = [maps.index.recording(drive) for drive in one.drives]
        if recordings[0] != recordings[1]:
            for own, other, apart_m in ((0, 1, one.apart_m), (1, 0, -one.apart_m)):
                number = maps.index.map_of(one.places[own])
                said[number][recordings[other]].append((one.places[own], one.places[other], apart_m))
    sigma_m = sigmas_m(maps.places)
    found = {}
    for number, others in sorted(said.items()):
        drive, first = maps.maps[number], maps.index.starts[number]
        moves_m = _moves_m(drive, first, [sorted(each, key=lambda said: said[0]) for each in others.values()], sigma_m)
        if moves_m is not None:
            found[number] = Placed(_moved(drive.places, moves_m))
    return found


def _along_m(one: ReferenceMap) -> Floats:
    """Meters (N,) driven, those of each segment far from those of all others."""
    along_m = one.places["route_m"].copy()
    for number, segment in enumerate(one.header.segments):
        along_m[segment.start : segment.end] += APART_M * number
    return along_m


def _moves_m(
    one: ReferenceMap, first: int, others: Sequence[list[tuple[int, int, Floats]]], sigma_m: Floats
) -> Floats | None:
    """How far each place of a drive is to be moved, (N, 2) east and north; None where nothing is said."""
    route_m, own = _along_m(one), sigma_m[first : first + len(one.places)]
    opinions = []
    for said in others:
        if len(said) >= SMOOTHED:
            rows = np.array([place for place, _, _ in said]) - first
            apart_m = np.stack([one_m for _, _, one_m in said])
            around = np.clip(np.arange(len(rows))[:, None] + np.arange(SMOOTHED) - 1, 0, len(rows) - 1)
            sigmas = sigma_m[[there for _, there, _ in said]]
            opinions.append((route_m[rows], rows, np.median(apart_m[around], axis=1), sigmas))
    if not opinions or np.isnan(route_m).any():
        return None
    knots = np.unique(np.concatenate([rows for _, rows, _, _ in opinions]))
    moves_m = np.zeros((len(knots), 2))
    for knot, row in enumerate(knots):
        values, weights = [np.zeros(2)], [own[row] ** -2.0]
        for at_m, _, apart_m, sigmas in opinions:
            nearest = int(np.abs(at_m - route_m[row]).argmin())
            if abs(at_m[nearest] - route_m[row]) <= HOLDS_M:
                values.append(apart_m[nearest])
                weights.append(1 / (sigmas[nearest] ** 2 + LANES_M**2))
        moves_m[knot] = [_median(np.array(axis), np.array(weights)) for axis in zip(*values, strict=True)]
    order = np.argsort(route_m[knots], kind="stable")
    at_m = route_m[knots][order]
    after = np.searchsorted(at_m, route_m).clip(1, len(at_m) - 1)  # there are SMOOTHED knots at least
    away_m = np.minimum(np.abs(route_m - at_m[after - 1]), np.abs(route_m - at_m[after]))
    weight = np.clip((ENDS_M - away_m) / (ENDS_M - HOLDS_M), 0.0, 1.0)
    return np.stack([weight * np.interp(route_m, at_m, moves_m[order, axis]) for axis in (0, 1)], axis=1)


def _median(values: Floats, weights: Floats) -> float:
    """The weighted median, between two values where both have half."""
    order = np.argsort(values, kind="stable")
    share = (np.cumsum(weights[order]) - weights[order] / 2) / weights.sum()
    return float(np.interp(0.5, share, values[order]))


def _moved(places: NDArray[np.void], moves_m: Floats) -> Floats:
    lat_deg, lon_deg = all_moved(places["lat_deg"], places["lon_deg"], moves_m)
    return np.stack([lat_deg, lon_deg, places["position_sigma_m"].astype(np.float64)])


@dataclass(frozen=True)
class _Seen:
    """A drive was driven over others: meters along it of the middle of a line, and a place of the other's drive."""

    at_m: float
    place_index: int
    middle: LineMiddle


def placed(one: ReferenceMap, maps: MapSet) -> Placed | None:
    """A drive without GPS, where those of one other recording have its places; None where it recognizes none of them.

    Only lines of cameras that looked the same way count: how far ahead others see is not known here.
    """
    seen = [each for segment in one.header.segments for each in _seen(one, segment, maps)]
    if not seen:
        return None
    # Those of one recording: both together are then no more than one recording is.
    (recording, _), *_ = Counter(each.middle.recording for each in seen).most_common(1)
    seen = [each for each in seen if each.middle.recording == recording]
    route, across_m = Route(maps), Config().rig.sigma_across_m
    ahead_m = np.array([each.middle.along_m - each.at_m for each in seen])
    at_m, drives = np.array([each.at_m for each in seen]), np.array([each.middle.segment for each in seen])
    rows = np.full((3, len(one.places)), np.nan)
    for row, route_m in enumerate(_along_m(one).tolist()):
        nearest = int(np.abs(at_m - route_m).argmin())
        away_m, best = abs(at_m[nearest] - route_m), seen[nearest]
        around = slice(max(0, nearest - LINES), nearest + LINES + 1)
        alike_m = ahead_m[around][drives[around] == best.middle.segment]
        along_m = route_m + float(np.median(alike_m))
        if away_m <= WITHIN_M and route.reaches(best.place_index, along_m):
            position = route.position(best.place_index, along_m - route.route_m(best.place_index))
            if position is not None:
                lines_m = best.middle.sigma_m, float(alike_m.std()), across_m
                sigma_m = math.hypot(position.sigma_m, *lines_m, DRIFT * away_m)
                rows[:, row] = position.lat_deg, position.lon_deg, sigma_m
    return None if np.isnan(rows).all() else Placed(rows, recording)


def _seen(one: ReferenceMap, segment: Segment, maps: MapSet) -> Iterator[_Seen]:
    """What a drive recognizes of the others."""
    config = config_as_mapped(one.header)
    config = msgspec.structs.replace(config, camera=msgspec.structs.replace(config.camera, view=segment.view))
    matcher, route, length = SequenceMatcher(maps, config), Route(maps), config.sequence_frames
    raw, routes_m = one.raw(), _along_m(one)
    for row in range(segment.start, segment.end):
        at_m = float(routes_m[row])
        match = matcher.push(raw[row].astype(np.float32), Travel(None if math.isnan(at_m) else at_m))
        if match is None or not match.accepted or (match.direction, match.order) != ("forward", "same"):
            continue
        middle = line_middle(match, route, length)
        if middle is not None and maps.index.view(middle.segment) == segment.view and not math.isnan(at_m):
            frames = row - middle.back
            yield _Seen(float(np.interp(frames, np.arange(len(routes_m)), routes_m)), match.place_index, middle)
