"""Whether positions would have been good enough: of each light, and of each stretch of road in it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.shadow.drives import WAYS, ShadowDrive
from sim.shadow.road import Span
from sim.shadow.sun import LIGHTS, Array

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
