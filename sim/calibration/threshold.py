"""The uniqueness from which a match is accepted, for a precision that the user chooses.

From a drive: a match is right if, after the rig's offset, its place is within the tolerance of the vehicle.
From the map alone: each of its frames is matched to the map without the frame's surroundings. All such matches are
wrong, as those of a vehicle off the map, and the threshold rejects all but the allowed share of them. On three
simulated streets of 1 km the threshold for 99 % was 1.145, 1.167 and 1.198, where another street driven on that map
needed 1.124, 1.135 and 1.142; on a real corridor 1.21, where recordings of other places stayed below 1.05. The map
alone does not show how well places are recognized in other light. If it has no positions and passes a place twice, it
shows nothing: the other pass of the same place is matched.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from edge.config import AcceptanceConfig, Config, RigConfig
from edge.errors import LookbackError
from edge.reference_map import COST_ONE, MapSet, ReferenceMap
from edge.sequence.search import NO_LINE
from edge.sequence.submap import Submap
from sim.calibration.sightings import Sighting
from sim.evaluation.metrics import Answers, precision_recall

TOLERANCE_M = 40.0
"""The paper's, for a road (section IV-B)."""

DEFAULT = AcceptanceConfig().uniqueness_min


@dataclass(frozen=True)
class Curve:
    """Results of each threshold, from the highest to the lowest; arrays (T,).

    precision: share of the accepted matches that is right; from the map alone, where all matches are wrong, the share
    that is rejected. accepted: number of accepted matches. answers: number of matches in all. stretches: how many of
    them share no frame with each other, and so are independent.
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
                f"no threshold reaches a precision of {precision:.1%}: the best is {self.precision.max(initial=0):.1%};"
                " record a drive more like that of the map, use longer sequences, or choose a lower precision"
            )
        last = good[-1]
        if last + 1 == len(self.thresholds):
            return float(self.thresholds[last])
        # Halfway to the next, which must be rejected, so that neither lies exactly on the threshold.
        return float(self.thresholds[last] + self.thresholds[last + 1]) / 2


def choose(curve: Curve, off_map: Sequence[float], precision: float, length: int) -> float:
    """The lowest threshold of that precision that also rejects this share of what was matched off the map.

    off_map: uniqueness of a drive's matches while it was off the map. With fewer than `length` of them nothing shows
    what is accepted there, and the threshold is at least the default. LookbackError where the precision is not reached.
    """
    lowest = curve.lowest_for(precision) if curve.precision.min() < precision else 1.0
    if len(off_map) < length:
        return max(lowest, DEFAULT)
    return max(lowest, float(np.quantile(off_map, precision)))


def curve_of_drive(seen: Sequence[Sighting], rig: RigConfig, tolerance_m: float, length: int) -> Curve:
    """From sightings with known positions; a vehicle off the map's drives makes every match wrong."""
    left_m = np.array([one.ahead_m - rig.ahead_m(one.direction, one.order) for one in seen])
    uniqueness = np.array([one.uniqueness for one in seen])
    correct = np.abs(left_m) <= tolerance_m  # NaN is not
    curve = precision_recall(Answers(uniqueness, correct, np.ones(len(seen), dtype=bool)))
    accepted = np.array([(uniqueness >= threshold).sum() for threshold in curve.thresholds])
    return Curve(curve.thresholds, curve.precision, accepted, len(seen), len(seen) // length)


def curve_of_map(reference_map: ReferenceMap, config: Config) -> Curve:
    """From the map alone: each place matched without its surroundings."""
    wrong = -np.sort([-uniqueness for uniqueness in _uniqueness_off_map(reference_map, config)])
    accepted = np.arange(1, len(wrong) + 1)
    return Curve(wrong, 1 - accepted / max(len(wrong), 1), accepted, len(wrong), len(wrong) // config.sequence.length)


def _uniqueness_off_map(reference_map: ReferenceMap, config: Config) -> Iterator[float]:
    """Uniqueness of the best match of each place after its own surroundings were removed."""
    header = reference_map.header
    map_set = MapSet.of(reference_map)
    (matcher,) = map_set.matchers
    missing = NO_LINE // (2 * config.sequence.length)  # no line through such a place is the best, and no sum overflows
    for segment in header.segments:
        # With the view of the segment's own camera: the region orders of the other would match its mirror image.
        camera = msgspec.structs.replace(config.camera, view=segment.view)
        config = msgspec.structs.replace(config, camera=camera)
        part = Submap([(0, header.places)], map_set, config)
        for place in range(segment.start, segment.end):
            costs = matcher.costs_of_encoded(reference_map.descriptors[:, place : place + 1])
            # In the row, and not only at the ends of lines: a reverse line would cross the true place in its middle.
            costs[..., part.neighborhood.around(place)] = missing
            match = part.push(costs)
            if match is None or match.distance * COST_ONE * config.sequence.length >= missing:
                continue
            alone = match.uniqueness * match.distance * COST_ONE * config.sequence.length >= missing
            yield 1.0 if alone else match.uniqueness
