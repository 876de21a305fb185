"""Drives that were never made, over a map: its own descriptors, changed as another light and another view change them.

After normalization, a place as the next drive will see it is alike to the same place of the map, to those around it,
and to nothing in particular. How much, was measured on simulated worlds by commit 386c0d62
(`python -m sim.research.evaluation.coverage --similarity`):

    query(i) = gain(i) * mean of map(i + k) over a few k  +  sqrt(1 - gain(i)^2) * noise(i)

The mean over neighbors is smaller where they differ: a place that changes within meters is found less often from
another lane. `gain` is that of the light, and wanders. `noise` is in part like nothing in the map, in part a random
mixture of the map's own descriptors, which wanders as slowly as they do: it resembles other places as much as strangers
do, and no place in particular.
All is shifted by a constant, as another light and camera shift the mean, until the online normalization has removed it.

Where both cameras look the same way, and places have map points, a drive also believes what keypoints showed on such
drives (BY_KEYPOINTS).

What cannot be known from the map is what will stand there instead: snow, a market, a parked truck.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from typing import Literal, TypeAlias, get_args

import msgspec
import numpy as np
from numpy.typing import NDArray

from edge.config import Config
from edge.descriptor.normalize import normalize
from edge.feed import View
from edge.keypoints.pose import FEWEST_POINTS
from edge.localization.dead_reckoning import Odometry, TurnAround
from edge.recognition.sequence_matcher import SequenceMatcher
from edge.reference_map import Drives, MapSet
from edge.sequence import MotionPrior, PlaceMatch
from sim.coverage.passes import Pass, road_between_m
from sim.world.scenario import LightName

Floats: TypeAlias = NDArray[np.float32]
Way: TypeAlias = Literal["home", "again"]
WAYS: tuple[Way, ...] = ("home", "again")
LIGHTS: tuple[LightName, ...] = get_args(LightName)


@dataclass(frozen=True)
class Similarity:
    """What a place seen on another drive has in common with the map.

    gains: by the light, with a map by day. neighbors: how far away, in meters, the places lie whose mean it looks like,
    and their weights. unlike: share of the noise's variance that is like nothing in the map.
    """

    gains: dict[LightName, float]
    neighbors: dict[float, float]
    unlike: float


AHEAD = {far_m: 1.0 - far_m / 48.0 for far_m in (4.0, 8.0, 12.0, 16.0, 20.0, 28.0, 36.0)}
"""Opposed views of a road share what is far ahead, the more the nearer the places are."""
LIKENESS: dict[tuple[bool, Way], Similarity] = {
    (True, "home"): Similarity(
        {"day": 0.53, "dusk": 0.42, "night": 0.40, "rain": 0.41, "snow": 0.34}, {4.0: 1.0, 6.0: 1.0}, unlike=0.61
    ),
    (True, "again"): Similarity(
        {"day": 0.70, "dusk": 0.53, "night": 0.50, "rain": 0.47, "snow": 0.26}, {0.0: 1.0}, unlike=0.45
    ),
    (False, "home"): Similarity(
        {"day": 0.40, "dusk": 0.33, "night": 0.30, "rain": 0.34, "snow": 0.33}, AHEAD, unlike=0.55
    ),
    (False, "again"): Similarity(
        {"day": 0.72, "dusk": 0.61, "night": 0.58, "rain": 0.54, "snow": 0.33}, AHEAD, unlike=0.37
    ),
}
"""By whether the camera looks as the map's did, and the way, since the way home is another lane."""
WANDERS, WANDERS_M, WANDERS_FASTER = 0.12, (8.0, 50.0), 0.64
"""Standard deviation of the gain, correlation lengths of its two parts, and the faster part's share of the variance."""
NOISE_ROWS, NOISE_M = 200, (6.0, 60.0)
"""Descriptors that the noise is mixed of, and correlation lengths of the weights of its two halves."""
SHIFTS: dict[LightName, float] = {"day": 0.16, "dusk": 0.31, "night": 0.41, "rain": 0.49, "snow": 1.05}
"""Root mean square by which the mean of another drive differs from the map's, in standard deviations of the map."""
RIGHT_M = 40.0
CHUNK = 512
BY_KEYPOINTS: dict[tuple[Way, LightName], tuple[float, float, float]] = {
    ("again", "dusk"): (4.0, 4.0, 0.992),
    ("again", "night"): (4.0, 6.0, 0.988),
    ("again", "snow"): (4.0, 50.0, 0.992),
    ("again", "rain"): (4.0, 4.0, 0.990),
    ("home", "dusk"): (4.0, 10.0, 0.937),
    ("home", "night"): (4.0, 42.0, 0.916),
    ("home", "snow"): (4.0, 60.0, 0.939),
}
"""Meters until a place is believed (median, 90 %), and the share of the frames then: the table of docs/keypoints.md,
where both cameras look the same way, with those of dusk for the day. Home by rain was not measured."""
BESIDE_M = 6.0
"""To which 0.87 to 0.89 of the frames have a pose there (docs/tables/keypoints.md)."""
QUANTILE_90, LOST_M = 1.2816, 200.0
"""Of the normal distribution; and the meters without a pose after which the daemon searches anew."""


@dataclass(frozen=True)
class Conditions:
    """A drive: over the map in its own direction again or back home, in which light, by a camera that looks where."""

    way: Way
    light: LightName
    view: View = "front"


class Rehearsal:
    """Drives over all segments of some maps, under some conditions."""

    def __init__(self, maps: MapSet, config: Config, conditions: Conditions) -> None:
        """config: with the maps' regions and spacing."""
        self._maps, self._conditions = maps, conditions
        self._config = msgspec.structs.replace(
            config, camera=msgspec.structs.replace(config.camera, view=conditions.view)
        )
        self._drives = Drives(maps, config.sampling.spacing_m)
        self._mean, self._deviation = maps.statistics()
        self._has_points = has_points(maps)

    def drive(self, seed: int) -> list[Pass]:
        """One drive: its pass over each segment, in the order of driving."""
        rng = np.random.default_rng(seed)
        segments = range(len(self._maps.index.segments))
        order = segments if self._conditions.way == "again" else reversed(segments)
        matcher = SequenceMatcher(self._maps, self._config)
        noise, turn_around = _Noise(self, rng), TurnAround()
        found, driven_m, before = [], 0.0, -1
        for segment in order:
            gap_m = road_between_m(self._maps, before, segment) if before >= 0 else 0.0
            if math.isinf(gap_m):
                matcher = SequenceMatcher(self._maps, self._config)
            elif before >= 0:
                for raw in self._unmapped(round(gap_m / self.spacing_m), noise):
                    driven_m += self.spacing_m
                    turn_around.add(None)
                    matcher.push(raw, MotionPrior(driven_m))
            found.append(self._pass(segment, matcher, turn_around, noise, rng, driven_m))
            driven_m, before = driven_m + float(np.ptp(found[-1].along_m)), segment
        return found

    @property
    def light(self) -> LightName:
        """Of the drives."""
        return self._conditions.light

    @property
    def spacing_m(self) -> float:
        """Mean distance between places."""
        return self._drives.spacing_m

    def look_alike(self, segment: int) -> bool:
        """Whether the camera looks the way that the map's did."""
        own, row = self._maps.index, self._maps.index.segment(segment)[0]
        number = own.map_of(row)
        header = self._maps.headers[number]
        mapped = next(one.view for one in header.segments if row - own.starts[number] < one.end)
        return (mapped != self._conditions.view) == (self._conditions.way == "home")

    def normalized(self, rows: NDArray[np.intp]) -> Floats:
        """Of some places of one map (n, R, D), each of length 1."""
        number = self._maps.index.map_of(int(rows[0]))
        raw = self._maps.maps[number].raw()[rows - self._maps.index.starts[number]].astype(np.float32)
        found = normalize(raw, self._mean, self._deviation)
        return _unit(found)

    def raw(self, unit: Floats, shift: Floats) -> Floats:
        """Raw descriptors (n, R, D) of normalized ones of length 1; shift (D,) in deviations."""
        values = unit * math.sqrt(unit[0].size) + shift
        return (values * self._deviation + self._mean).astype(np.float32)

    def places(self, rng: np.random.Generator, count: int) -> Floats:
        """So many places at random."""
        starts = self._maps.index.starts
        number = int(rng.integers(len(self._maps.maps)))
        first, end = starts[number], starts[number] + self._maps.headers[number].places
        return self.normalized(np.sort(rng.integers(first, end, count)))

    def _unmapped(self, count: int, noise: _Noise) -> Iterator[Floats]:
        if count:
            yield from self.raw(noise.next(count, 0.0), noise.shift)

    def _frames(self, segment: int, noise: _Noise, rng: np.random.Generator) -> Iterator[Floats]:
        """Raw descriptors (n, R, D) of a drive over one segment, in pieces."""
        start, end = self._maps.index.segment(segment)
        rows, alike = self._rows(segment), self.look_alike(segment)
        likeness = LIKENESS[alike, self._conditions.way]
        wandering = WANDERS * _wandering(len(rows), WANDERS_M, self.spacing_m, rng)
        gains = np.clip(likeness.gains[self._conditions.light] + wandering, 0.0, 1.0).astype(np.float32)
        far_m = np.outer(list(likeness.neighbors), (-1, 1)).reshape(-1, 1)
        steps = np.rint(far_m / self.spacing_m).astype(np.intp)
        weights = np.repeat(list(likeness.neighbors.values()), 2).astype(np.float32)
        weights /= weights.sum()
        for first in range(0, len(rows), CHUNK):
            here = slice(first, first + CHUNK)
            around = np.clip(rows[here] + steps, start, end - 1)
            nearby = np.unique(around)
            normalized = self.normalized(nearby)
            places = np.zeros((around.shape[1], *normalized.shape[1:]), dtype=np.float32)
            for weight, places_at in zip(weights, np.searchsorted(nearby, around), strict=True):
                places += weight * normalized[places_at]
            gain = gains[here, np.newaxis, np.newaxis]
            unit = (gain * places + np.sqrt(1 - gain**2) * noise.next(len(places), likeness.unlike)).astype(np.float32)
            # Where the cameras look in opposed directions, what was left is right.
            yield self.raw(unit if alike else unit[:, ::-1], noise.shift)

    def _rows(self, segment: int) -> NDArray[np.intp]:
        """Its places in the order of driving."""
        rows = np.arange(*self._maps.index.segment(segment))
        return rows[::-1] if self._conditions.way == "home" else rows

    def _pass(
        self,
        segment: int,
        matcher: SequenceMatcher,
        turn_around: TurnAround,
        noise: _Noise,
        rng: np.random.Generator,
        driven_m: float,
    ) -> Pass:
        along_m = np.array([self._drives.along_m(int(row)) for row in self._rows(segment)])
        where_m = self._drives.positions_m(np.full(len(along_m), segment), along_m).tolist()
        believed = np.zeros(len(along_m), dtype=bool)
        for at, raw in enumerate(chain.from_iterable(self._frames(segment, noise, rng))):
            turn_around.add(None if math.isnan(where_m[at][0]) else Odometry(0, *where_m[at]))
            now_m = driven_m + abs(float(along_m[at] - along_m[0]))
            match = matcher.push(raw, MotionPrior(now_m, course_rad=turn_around.course_rad))
            believed[at] = match is not None and match.accepted and self._is_right(match, segment, along_m[at])
        figures = figures_of(self._conditions)
        if figures and self.look_alike(segment):
            believed |= by_keypoints(self._has_points[self._rows(segment)], along_m, figures, rng)
        return Pass(segment, along_m, believed)

    def _is_right(self, match: PlaceMatch, segment: int, along_m: float) -> bool:
        is_here = self._drives.drive_of(match.place_index) == segment
        return is_here and abs(self._drives.along_m(match.place_index) - along_m) <= RIGHT_M


def figures_of(conditions: Conditions) -> tuple[float, float, float] | None:
    """Of BY_KEYPOINTS; None where they were not measured."""
    return BY_KEYPOINTS.get((conditions.way, "dusk" if conditions.light == "day" else conditions.light))


def spell_coverage(maps: MapSet, conditions: Conditions) -> list[str]:
    """For people: whether rehearsed drives count keypoints, where the maps have any."""
    views, way = {one.view for header in maps.headers for one in header.segments}, conditions.way
    if all(header.keypoints_key is None for header in maps.headers):
        return []
    if all((view != conditions.view) != (way == "home") for view in views):
        return ["Without keypoints: they need a camera that looks the way the map's did."]
    if figures_of(conditions):
        words = f"to {BESIDE_M:g} m beside the lane at {100 * has_points(maps).mean():.0f} % of the places"
        return [f"With keypoints, as measured on simulated roads {way} by {conditions.light}: poses come {words}."]
    return [f"Without keypoints: {way} by {conditions.light} they were not measured."]


def has_points(maps: MapSet) -> NDArray[np.bool_]:
    """Whether a pose can be computed from each place (N,)."""
    found = np.zeros(maps.index.places, dtype=bool)
    for start, one in zip(maps.index.starts, maps.maps, strict=False):
        if one.keypoints is not None:
            enough = np.isfinite(one.keypoints["sigma"]).sum(axis=1) >= FEWEST_POINTS
            found[start : start + len(enough)] = enough
    return found


def by_keypoints(
    has_points: NDArray[np.bool_],
    along_m: NDArray[np.float64],
    figures: tuple[float, float, float],
    rng: np.random.Generator,
) -> NDArray[np.bool_]:
    """Which frames (n,) of a drive over places, in its order, are believed by keypoints; figures: of BY_KEYPOINTS.

    It begins anew after LOST_M without points; the logarithm of the meters that this takes is normal.
    """
    median_m, most_m, share = figures
    believed, last_m, from_m = np.zeros(len(along_m), dtype=bool), -math.inf, 0.0
    driven_m = np.abs(along_m - along_m[0])
    for at in np.flatnonzero(has_points):
        if driven_m[at] - last_m > LOST_M:
            from_m = driven_m[at] + median_m * (most_m / median_m) ** (rng.normal() / QUANTILE_90)
        last_m, believed[at] = driven_m[at], driven_m[at] >= from_m
    return believed & (rng.random(len(believed)) < share)


class _Noise:
    """What a drive shows that the map does not."""

    def __init__(self, rehearsal: Rehearsal, rng: np.random.Generator) -> None:
        self._rng, self._spacing_m = rng, rehearsal.spacing_m
        self._sources = _flipped(rehearsal.places(rng, NOISE_ROWS), rng)
        self._weights = rng.normal(size=len(self._sources))
        strangers = rehearsal.places(rng, NOISE_ROWS)
        shift = np.tensordot(rng.normal(size=len(strangers)), strangers, axes=1).mean(axis=0)
        shift_by = SHIFTS[rehearsal.light]
        self.shift: Floats = (shift_by * shift / max(float(np.sqrt(np.mean(shift**2))), 1e-12)).astype(np.float32)

    def next(self, count: int, unlike: float) -> Floats:
        """Of the next frames (count, R, D), each of length 1; unlike: share that is like nothing in the map."""
        half = len(self._weights) // 2
        kept = np.exp(-self._spacing_m / np.repeat(NOISE_M, [half, len(self._weights) - half]))
        weights = np.empty((count, len(self._weights)))
        for row in range(count):
            new = self._rng.normal(size=len(kept))
            self._weights = weights[row] = kept * self._weights + np.sqrt(1 - kept**2) * new
        mixed = np.tensordot(weights.astype(np.float32), self._sources, axes=1)
        strange: Floats = np.asarray(self._rng.normal(size=mixed.shape), dtype=np.float32)
        return (math.sqrt(1 - unlike) * _unit(mixed) + math.sqrt(unlike) * _unit(strange)).astype(np.float32)


def _unit(rows: NDArray[np.floating]) -> Floats:
    """Rows (n, R, D), each of length 1."""
    lengths = np.sqrt(np.einsum("nrd,nrd->n", rows, rows))
    unit: Floats = (rows / np.maximum(lengths, 1e-12)[:, np.newaxis, np.newaxis]).astype(np.float32)
    return unit


def _flipped(places: Floats, rng: np.random.Generator) -> Floats:
    """Half of them with left and right exchanged."""
    flip = rng.random(len(places)) < 0.5
    return np.where(flip[:, np.newaxis, np.newaxis], places[:, ::-1], places)


def _wandering(
    count: int, lengths_m: tuple[float, float], spacing_m: float, rng: np.random.Generator
) -> NDArray[np.float64]:
    """A random process (count,) of variance 1 with two correlation lengths."""
    kept = np.exp(-spacing_m / np.array(lengths_m))
    values = np.empty((count, 2))
    value = rng.normal(size=2)
    for row in range(count):
        values[row] = value
        value = kept * value + np.sqrt(1 - kept**2) * rng.normal(size=2)
    return values @ np.sqrt([WANDERS_FASTER, 1 - WANDERS_FASTER])
