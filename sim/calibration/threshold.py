"""The confidence from which a place is believed, for a precision that the user chooses.

From a drive: a match is right if, after the rig's offset, its place is within the tolerance of the vehicle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.config import AcceptanceConfig, RigConfig
from edge.errors import LookbackError
from sim.calibration.offset_samples import OffsetSample
from sim.evaluation.metrics import Answers, precision_recall

DEFAULT = AcceptanceConfig().confidence_from


@dataclass(frozen=True)
class Curve:
    """Results of each threshold, from the highest to the lowest; arrays (T,).

    precision: share of the accepted matches that is right. accepted: number of accepted matches. answers: number of
    matches in all. stretches: how many of them share no frame with each other, and so are independent.
    """

    thresholds: NDArray[np.float64]
    precision: NDArray[np.float64]
    accepted: NDArray[np.int64]
    answers: int
    stretches: int

    def lowest_for(self, precision: float) -> float:
        """The lowest threshold of at least that precision; LookbackError if there is none."""
        good = np.flatnonzero(self.precision >= precision)
        if not good.size:
            raise LookbackError(
                f"no threshold reaches a precision of {100 * precision:.1f} %: the best is"
                f" {100 * self.precision.max(initial=0):.1f} %;"
                " record a drive more like that of the map, use longer sequences, or choose a lower precision"
            )
        last = good[-1]
        if last + 1 == len(self.thresholds):
            return float(self.thresholds[last])
        # Halfway to the next, which must be rejected, so that neither lies exactly on the threshold.
        return float(self.thresholds[last] + self.thresholds[last + 1]) / 2


def choose(curve: Curve, off_map: Sequence[float], precision: float) -> float:
    """The lowest threshold of that precision that also rejects this share of what was matched off the map.

    off_map: confidence of the drives' matches while they were off the map. At least the default: one drive shows too
    little of what lies off a map to go below it. LookbackError where the precision is not reached.
    """
    lowest = curve.lowest_for(precision) if curve.precision.min() < precision else DEFAULT
    return max(DEFAULT, lowest, float(np.quantile(off_map, precision)) if off_map else DEFAULT)


def curve_of_drive(seen: Sequence[OffsetSample], rig: RigConfig, tolerance_m: float, length: int) -> Curve:
    """From samples with known positions; a vehicle off the map's drives makes every match wrong."""
    left_m = np.array([one.ahead_m - rig.ahead_m(one.direction, one.order) for one in seen])
    confidence = np.array([one.confidence for one in seen])
    correct = np.abs(left_m) <= tolerance_m  # NaN is not
    curve = precision_recall(Answers(confidence, correct, np.ones(len(seen), dtype=bool)))
    accepted = np.array([(confidence >= threshold).sum() for threshold in curve.thresholds])
    return Curve(curve.thresholds, curve.precision, accepted, len(seen), len(seen) // length)
