"""What is driven to count how often errors exceed their protection levels: what is rare is drawn often and weighted."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from edge.localization.claims import STRETCH_WRONG
from tests.localization.route_bench import GPS_M, LANE_M, reckoned, rng_of
from tests.localization.route_course import Course, Stretch, road_line

ROAD_M, STRETCH_M = 3000.0, 500.0
UNMAPPED, RESEMBLES = 0.1, 0.1
OFF_HOW = "", "turn -90", "turn 180", "stop 45", "reverse 2"
SHIFTED_M = (5.0, 500.0)
"""Least and greatest shift of a stretch that is wrong; its logarithm is spread evenly."""


class Shares(NamedTuple):
    """Of all drives: with parallax, on a map of several segments, steered by the estimate, of OFF_HOW each, and with an
    odometer that is drawn from UNDERREADS. How many times as wide odometer and heading (`wider`), and the offsets of
    the map and of the lane (`beside`), are drawn. Of the other stretches where one is shifted: shifted too (`further`).
    """

    parallax: float = 0.5
    several: float = 0.3
    steers: float = 0.5
    off: tuple[float, ...] = (0.85, 0.0375, 0.0375, 0.0375, 0.0375)
    underreads: float = 0.0
    wider: float = 1.5
    beside: float = 1.0
    further: float = STRETCH_WRONG


OCCUR = Shares()


class Class(NamedTuple):
    """Drives that have something in common, and how many are a group.

    shifts_m: limits of the shift of a stretch that is wrong; shifts: the share of each range between them that is
    drawn; hides: the share that is drawn near to what odometer and heading are wrong by there. Empty: no stretch is
    wrong. shares: of what else is drawn.
    """

    shifts_m: tuple[float, ...] = ()
    shifts: tuple[float, ...] = ()
    hides: float = 0.0
    shares: Shares = OCCUR
    together: int = 20


SELDOM_OFF = 0.94, 0.01, 0.01, 0.02, 0.02
CLASSES = {
    "right": Class(shares=Shares(parallax=0.1, steers=0.8, wider=1.0, beside=1.4), together=50),
    "shifted by 5 to 8 m": Class((5.0, 6.3, 8.0), (0.15, 0.85), 0.0, Shares(0.5, 0.2, 0.65, SELDOM_OFF)),
    "by 8 to 40 m": Class(
        (8.0, 10.0, 25.0, 40.0),
        (0.1, 0.8, 0.1),
        0.6,
        Shares(off=(0.86, 0.01, 0.01, 0.02, 0.10), underreads=0.3),
    ),
    "by 40 to 500 m": Class(
        (40.0, 80.0, 250.0, 500.0),
        (0.6, 0.3, 0.1),
        0.6,
        Shares(several=0.7, off=(0.82, 0.02, 0.02, 0.1, 0.04), wider=2.0, further=0.05),
        together=50,
    ),
}
"""Where a shift is hardest to notice, between 8 and 40 m, many drives come near, and some of them much more often.

What the drives that come near have in common is drawn more often, as 1,600 drives with equal shares showed. Of 990
right ones, those that came to half of their level had no parallax, steered (81 %, of all 47 %), and had map and lane
off by 1.3 times as much; odometer and heading were as those of others. Of 790 with a shift of 40 to 500 m, the seven
that came to 0.6 most often had one of 45 to 129 m, and odometer and heading were together off by 2 to 3.3 sigma; of
1,600 later ones, the only one beyond 0.75 had a second stretch shifted. In these two classes few drives come near: of
100 right ones three were all that came to 0.6. So more of them are a group.
"""
SCALE, HEADING_DEG = 0.03, 1.5
"""Standard deviations of odometer and heading."""
HIDES = 0.4, 0.5
"""Standard deviations of a shift's size, of its logarithm, and of its direction, in radians, from what it hides. Of the
drives that came nearest to their levels most had an odometer or a heading that was wrong by about as much."""
UNDERREADS = NormalDist(2.2, 0.7)
"""In SCALE: of 1,600 drives those that came nearest had such an odometer, which a shift hides, and which hides it."""


class Drawn:
    """Random numbers of which some are drawn more often than they occur.

    weight: how often all that was drawn occurs, over how often it is drawn.
    """

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng, self.weight = rng, 1.0

    def choice(self, occur: Sequence[float], shares: Sequence[float]) -> int:
        """One of several, drawn by `shares`."""
        found = int(self.rng.choice(len(shares), p=shares))
        self.weight *= occur[found] / shares[found]
        return found

    def whether(self, occurs: float, share: float) -> bool:
        """True in `share` of all cases."""
        return self.choice((1 - occurs, occurs), (1 - share, share)) == 1

    def normal(self, wider: float, *, underreads: float = 0.0) -> float:
        """Of a standard normal distribution: drawn from one that is wider, and a share from UNDERREADS."""
        whole = NormalDist(0.0, wider)
        of = UNDERREADS if self.rng.random() < underreads else whole
        drawn = float(self.rng.normal(of.mean, of.stdev))
        often = (1 - underreads) * whole.pdf(drawn) + underreads * UNDERREADS.pdf(drawn)
        self.weight *= NormalDist().pdf(drawn) / often
        return drawn

    def shift_m(self, of_class: Class, drift_m: tuple[float, float]) -> tuple[float, float]:
        """East and north of a stretch that is wrong; drift_m: of where the vehicle is there by reckoning alone."""
        rng, hides, limits = self.rng, of_class.hides, [math.log(limit) for limit in of_class.shifts_m]
        least, most, whole = limits[0], limits[-1], math.log(SHIFTED_M[1] / SHIFTED_M[0])
        hidden_m = min(max(math.hypot(*drift_m), of_class.shifts_m[0]), of_class.shifts_m[-1])
        size = NormalDist(math.log(hidden_m), HIDES[0])
        below, inside, aside = size.cdf(least), size.cdf(most) - size.cdf(least), NormalDist(0.0, HIDES[1])
        toward = math.atan2(*drift_m)
        if rng.random() < hides:
            found, angle = size.inv_cdf(below + rng.random() * inside), toward + float(rng.normal(0.0, aside.stdev))
        else:
            part = int(rng.choice(len(of_class.shifts), p=of_class.shifts))
            found, angle = float(rng.uniform(limits[part], limits[part + 1])), float(rng.uniform(0, math.tau))
        part = int(np.searchsorted(limits[1:-1], found))
        anywhere = of_class.shifts[part] / (limits[part + 1] - limits[part]) / math.tau
        turned = math.remainder(angle - toward, math.tau)
        near = size.pdf(found) / inside * sum(aside.pdf(turned + turn * math.tau) for turn in (-1, 0, 1))
        self.weight *= 1 / (whole * math.tau) / ((1 - hides) * anywhere + hides * near)
        return math.exp(found) * math.sin(angle), math.exp(found) * math.cos(angle)


def stretches(drawn: Drawn, of_class: Class) -> tuple[list[Stretch], int]:
    """Of a map, some missing, in one drive or several; and the number of the one that is shifted, -1 if none is.

    By how much that is, `Drawn.shift_m` says; others are shifted by chance.
    """
    rng = drawn.rng
    begins_m = [at for at in np.arange(0.0, ROAD_M, STRETCH_M) if at == 0 or rng.random() >= UNMAPPED]
    several, count = drawn.whether(OCCUR.several, of_class.shares.several), len(begins_m)
    least, most = map(math.log, SHIFTED_M)
    far_m, is_shifted, one = np.exp(rng.uniform(least, most, count)), np.zeros(count, bool), -1
    if of_class.shifts:
        one = int(rng.integers(count))
        further = of_class.shares.further
        is_shifted[:] = [at == one or drawn.whether(STRETCH_WRONG, further) for at in range(count)]
        drawn.weight *= count * STRETCH_WRONG / is_shifted.sum()
    else:
        drawn.weight *= (1 - STRETCH_WRONG) ** count
    found: list[Stretch] = []
    for begins, by_m, angle in zip(begins_m, far_m * is_shifted, rng.uniform(0, 2 * math.pi, count), strict=True):
        continues = bool(found) and found[-1].ends_m == begins and not several
        shift = by_m * math.sin(angle), by_m * math.cos(angle)
        found.append(Stretch(float(begins), float(begins) + STRETCH_M, *shift, continues=continues))
    return found, one


def drift_m(found: Course, seed: int, at_m: float) -> tuple[float, float]:
    """By how much odometer and heading are wrong by then, east and north, since GPS was lost."""
    line, _ = road_line(found.road_m, rng_of(seed))
    moved_m = line[int(at_m)] - line[int(GPS_M)]
    seen_m = reckoned(moved_m, math.radians(found.heading_deg or 0.0), 1 + (found.scale or 0.0))
    east_m, north_m = (seen_m - moved_m).tolist()
    return east_m, north_m


def course(seed: int, of_class: Class = Class()) -> tuple[Course, float]:  # noqa: B008  # frozen
    """A drive of a class, and its weight, see `Drawn`."""
    rng = np.random.default_rng([seed, 17])
    drawn, shares = Drawn(rng), of_class.shares
    mapped, shifted = stretches(drawn, of_class)
    missing = set(np.arange(0.0, ROAD_M, STRETCH_M)) - {one.begins_m for one in mapped}
    alias = (math.inf, math.inf)
    if missing and rng.random() < RESEMBLES:
        begins_m = float(rng.choice(sorted(missing))) + 100.0
        alias = begins_m, begins_m + 128.0
    off_how = OFF_HOW[drawn.choice(OCCUR.off, shares.off)]
    map_sigma_m, beside = mapped[0].sigma_m / math.sqrt(2), shares.beside
    found = Course(
        road_m=ROAD_M,
        stretches=tuple(mapped),
        map_off_m=(map_sigma_m * drawn.normal(beside), map_sigma_m * drawn.normal(beside)),
        lane_m=LANE_M * drawn.normal(beside),
        scale=SCALE * drawn.normal(shares.wider, underreads=shares.underreads),
        heading_deg=HEADING_DEG * drawn.normal(shares.wider),
        off_at_m=float(rng.uniform(600, 2400)) if off_how else math.inf,
        off_how=off_how,
        alias=alias,
        alias_from_m=30.0,
        steers=drawn.whether(OCCUR.steers, shares.steers),
        parallax=drawn.whether(OCCUR.parallax, shares.parallax),
        speed_mps=float(rng.uniform(3, 12)),
    )
    if of_class.shifts:
        wrong = mapped[shifted]
        at_m = float(rng.uniform(wrong.begins_m, wrong.ends_m))
        east_m, north_m = drawn.shift_m(of_class, drift_m(found, seed, at_m))
        mapped[shifted] = replace(wrong, east_m=east_m, north_m=north_m)
        found = replace(found, stretches=tuple(mapped))
    return found, drawn.weight
