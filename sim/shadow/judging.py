"""Whether positions would have been good enough: of each light, and of each stretch of road in it."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.geodesy import Origin, east_north, moved
from sim.shadow.drives import LIGHTS, WAYS, Array, ShadowDrive

NEAR_M = 15.0
"""Within it a drive is on the same road: lanes and the errors of GPS; beyond, the road beside."""
STEP_M = 5.0
LONGEST_STEP_M = 200.0
"""Between two positions: beyond, nobody knows which road lies between them."""
JUST_LAID = 10
"""Steps within which a drive does not come along the road that it began itself."""
TURNED_DEG = 60.0
COMPASS = ("north", "northeast", "east", "southeast", "south", "southwest", "west", "northwest")


@dataclass
class Span:
    """A stretch of road in one direction; points: (latitude, longitude) of the drive that was there first."""

    heading_deg: float
    points: list[Origin] = field(default_factory=list)
    length_m: float = 0.0

    @property
    def name(self) -> str:
        """Where it begins, and where it leads."""
        lat_deg, lon_deg = self.points[0]
        return f"from {lat_deg:.5f}, {lon_deg:.5f} {COMPASS[round(self.heading_deg / 45) % 8]}"


class Road:
    """The stretches so far; a drive that comes along one belongs to it, and one where nobody was begins others."""

    def __init__(self, length_m: float) -> None:
        self._length_m = length_m
        self.spans: list[Span] = []
        self._origin: Origin | None = None
        # By cells of NEAR_M: east and north in meters, heading in degrees, stretch and step of the points on the road.
        self._points: defaultdict[tuple[int, int], list[tuple[float, float, float, int, int]]] = defaultdict(list)
        self._step = 0

    def follow(self, drive: ShadowDrive) -> NDArray[np.intp]:
        """The stretch (N,) of each record of a drive, -1 where GPS did not say where it is."""
        found = np.full(len(drive.at_deg), -1, dtype=np.intp)
        known = np.flatnonzero(~np.isnan(drive.gps_m) & ~np.isnan(drive.at_deg[:, 0]))
        if not known.size:
            return found
        self._origin = self._origin or (float(drive.at_deg[known[0], 0]), float(drive.at_deg[known[0], 1]))
        self._step += JUST_LAID
        at_m = east_north(drive.at_deg[:, 0], drive.at_deg[:, 1], self._origin)
        current = -1
        for before, row in zip(known[:-1].tolist(), known[1:].tolist(), strict=True):
            step_m = at_m[row] - at_m[before]
            if not STEP_M / 10 < float(np.hypot(*step_m)) <= LONGEST_STEP_M:
                found[row] = found[before]
                continue
            heading_deg = math.degrees(math.atan2(step_m[0], step_m[1])) % 360
            points_m = _between(at_m[before], at_m[row])
            for point_m in points_m:
                current = self._at(point_m, heading_deg, current, float(np.hypot(*step_m)) / len(points_m))
            found[row] = current
            if found[before] < 0:
                found[before] = current
        return found

    def _at(self, point_m: Array, heading_deg: float, current: int, length_m: float) -> int:
        """The stretch of a point of a drive, which stands for so many meters; a new one where there is none."""
        east_m, north_m = float(point_m[0]), float(point_m[1])
        self._step += 1
        cell = math.floor(east_m / NEAR_M), math.floor(north_m / NEAR_M)
        near = [
            (math.hypot(east_m - one[0], north_m - one[1]), one[3])
            for east in (-1, 0, 1)
            for north in (-1, 0, 1)
            for one in self._points.get((cell[0] + east, cell[1] + north), ())
            if self._step - one[4] > JUST_LAID and abs((one[2] - heading_deg + 180) % 360 - 180) <= TURNED_DEG
        ]
        apart_m, known = min(near, default=(math.inf, -1))
        if apart_m <= NEAR_M:
            return known
        newest = self.spans[-1] if self.spans else None
        if newest is None or current != len(self.spans) - 1 or newest.length_m >= self._length_m:
            newest = Span(heading_deg)
            self.spans.append(newest)
        assert self._origin is not None
        newest.points.append(moved(*self._origin, east_m, north_m))
        newest.length_m += length_m
        self._points[cell].append((east_m, north_m, heading_deg, len(self.spans) - 1, self._step))
        return len(self.spans) - 1


def _between(before_m: Array, now_m: Array) -> list[Array]:
    """Points STEP_M apart, up to the second."""
    count = max(1, round(float(np.hypot(*(now_m - before_m))) / STEP_M))
    return [before_m + (now_m - before_m) * step / count for step in range(1, count + 1)]


FACTORS = np.geomspace(0.1, 10.0, 461)
"""That a standard deviation may have to be multiplied by, 1 % apart."""
LIKELY = 1.92
"""By how much the logarithm of the likelihood falls at both ends of a 95 % interval: half of chi-squared's 3.84."""
TRUE_WITHIN = 1.2
FEWEST = 10
"""Independent comparisons of which a factor is given."""
BEYOND = 3.0


class Factor(NamedTuple):
    """By what a standard deviation has to be multiplied to be true; 95 % interval."""

    best: float
    least: float
    most: float

    @property
    def is_too_small(self) -> bool:
        """Whether the standard deviation is: more than a fifth, and not by chance."""
        return self.best >= TRUE_WITHIN and self.least > 1

    @property
    def is_too_large(self) -> bool:
        """Whether it is larger than it had to be."""
        return self.best <= 1 / TRUE_WITHIN and self.most < 1


class GpsComparison(NamedTuple):
    """Comparisons of some drives in one light, as `ShadowDrive` has them, of those that GPS judges."""

    off_m: Array
    sigma_m: Array
    gps_m: Array
    late_m: Array
    weight: Array
    way: NDArray[np.intp]

    @property
    def error_m(self) -> Array:
        """From where GPS has the vehicle."""
        return np.asarray(np.hypot(*self.off_m.T))

    @property
    def whole_sigma_m(self) -> Array:
        """Of what lies between the two: ours, that of GPS, and what they differ in time."""
        return np.asarray(np.sqrt(np.sum(self.sigma_m**2, axis=1) + 2 * self.gps_m**2 + self.late_m**2))

    @property
    def beyond(self) -> int:
        """How many are further off than BEYOND of that."""
        return int(np.sum(self.error_m > BEYOND * self.whole_sigma_m))

    def factor(self, axis: int) -> Factor | None:
        """Along (0) or across (1), by maximum likelihood; None where there is too little to say."""
        if self.weight.sum() < FEWEST:
            return None
        other = self.gps_m**2 + (self.late_m**2 if axis == 0 else 0.0)
        own = self.sigma_m[:, axis] ** 2
        variance = FACTORS[:, None] ** 2 * own + other
        # An error of GPS lasts for minutes: only the share of the variance that is ours is independent of what was.
        weight = self.weight * own / (own + other)
        likelihood = -0.5 * (np.log(variance) + self.off_m[:, axis] ** 2 / variance) @ weight
        inside = FACTORS[likelihood >= likelihood.max() - LIKELY]
        return Factor(float(FACTORS[likelihood.argmax()]), float(inside[0]), float(inside[-1]))

    @property
    def bias_m(self) -> tuple[float, float]:
        """Ahead and to the left, on average."""
        ahead_m, left_m = np.average(self.off_m, axis=0, weights=self.weight)
        return float(ahead_m), float(left_m)

    @property
    def spread_m(self) -> tuple[float, float, float]:
        """Median, 95 % and largest error."""
        median_m, most_m, largest_m = np.percentile(self.error_m, [50, 95, 100])
        return float(median_m), float(most_m), float(largest_m)

    @property
    def keys(self) -> str:
        """The keys of [rig] that its standard deviations along the road come from."""
        return ", ".join(f"sigma_{WAYS[way]}_m" for way in sorted(set(self.way.tolist())))


def compared(drives: Sequence[ShadowDrive], chosen: Sequence[NDArray[np.bool_]]) -> GpsComparison:
    """Of the chosen (N,) records of each drive those that GPS judges."""
    rows = [here & one.is_compared for one, here in zip(drives, chosen, strict=True)]
    names = ("off_m", "sigma_m", "gps_m", "late_m", "weight", "way")
    parts = (np.concatenate([getattr(one, name)[row] for one, row in zip(drives, rows, strict=True)]) for name in names)
    return GpsComparison(*parts)


@dataclass(frozen=True)
class SpanReadiness:
    """A stretch in one light. drives: that judge it, not those that began there; driven_m: of all of them.

    why: why it is not ready, "" where it is. silent_m: the longest way without a position up to there, of all drives.
    published: share of the records with one.
    """

    span: Span
    light: str
    drives: int
    driven_m: float
    silent_m: float
    published: float
    positions: GpsComparison
    why: str

    @property
    def is_tried(self) -> bool:
        """Whether it is known not to be ready, and not for want of drives."""
        return bool(self.why) and not self.why.startswith(MORE)


MORE = "more drives are needed"


def judge(
    span: Span,
    light: int,
    drives: Sequence[ShadowDrive],
    on_span: Sequence[NDArray[np.bool_]],
    *,
    fewest: int,
    within_m: float,
    drift: float,
) -> SpanReadiness | None:
    """A stretch in one light; None where no drive passed in it.

    on_span: the records (N,) of each drive that are there. fewest: drives that it needs. within_m: error and drift that
    are accepted; drift: of the distance driven without a position.
    """
    here = [there & (one.light == light) for one, there in zip(drives, on_span, strict=True)]
    passed = [(one, rows) for one, rows in zip(drives, here, strict=True) if rows.any()]
    if not passed:
        return None
    beyond_start = [(one, rows & one.is_beyond_start) for one, rows in passed]
    count = sum(bool(rows.any()) for _, rows in beyond_start)
    positions = compared([one for one, _ in passed], [rows for _, rows in passed])
    silent_m = max(float(one.silent_m[rows].max()) for one, rows in passed)
    published = np.concatenate([one.is_published[rows] for one, rows in passed])
    largest_m = float(positions.error_m.max(initial=0.0))
    why = ""
    if count and not published.any():
        why = "no position came there"
    elif drift * silent_m > within_m:
        why = f"{silent_m:.0f} m without a position"
    elif largest_m > within_m:
        why = f"off by {largest_m:.0f} m"
    elif positions.beyond:
        why = f"{positions.beyond} beyond {BEYOND:g} sigmas"
    elif count < fewest:
        why = f"{MORE}, {count} of {fewest}"
    driven_m = sum(float(one.driven_m[rows].sum()) for one, rows in passed)
    return SpanReadiness(span, LIGHTS[light], count, driven_m, silent_m, float(published.mean()), positions, why)


def ready_m(stretches: Sequence[SpanReadiness]) -> tuple[float, float]:
    """Meters that are ready, of all."""
    return math.fsum(one.span.length_m for one in stretches if not one.why), math.fsum(
        one.span.length_m for one in stretches
    )
