"""The uniqueness from which a match is believed, for the precision that the user names.

From a drive: a match is right if, after the rig's offset, its place is within the tolerance of the vehicle.
From the map alone: its drives are driven again by its own camera, in a map from which the surroundings of each frame
are missing. Whatever is then matched is wrong, as for a vehicle off the map, and the threshold refuses all but the
allowed share of it. On three simulated streets of 1 km 99 % came to 1.145, 1.167 and 1.198, where another street driven
on that map came to 1.124, 1.135 and 1.142; on a real corridor to 1.21, where recordings of elsewhere stayed below 1.05.
Nothing is learned of how well places are recognized in other light, which only a drive shows; and of a map without
positions that passes a place twice nothing at all, since the place itself is then what is found.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from edge.config import Config, RigConfig
from edge.errors import LookbackError
from edge.reference_map import COST_ONE, MapSet, ReferenceMap
from edge.sequence.search import NO_LINE
from edge.sequence.submap import Submap
from sim.calibration.sightings import Sighting
from sim.evaluation.metrics import Answers, precision_recall

TOLERANCE_M = 40.0
"""The paper's, for a road (section IV-B)."""


@dataclass(frozen=True)
class Curve:
    """What each threshold would give, from the highest to the lowest; arrays (T,).

    precision: of the accepted, the share that is right; or, from the map alone, of matches that are all wrong, the
    share that is refused. accepted: how many are. answers: how many matches it rests on, and stretches: how many of
    these share no frame with each other, which is what they prove.
    """

    thresholds: NDArray[np.float64]
    precision: NDArray[np.float64]
    accepted: NDArray[np.int64]
    answers: int
    stretches: int

    def lowest_for(self, precision: float) -> float:
        """The threshold with the most accepted matches that still has that precision; LookbackError if none has."""
        good = np.flatnonzero(self.precision >= precision)
        if not good.size:
            raise LookbackError(
                f"no threshold reaches a precision of {precision:.1%}: the best is {self.precision.max(initial=0):.1%};"
                " drive the route again more like the map was, use longer sequences, or ask for less"
            )
        last = good[-1]
        if last + 1 == len(self.thresholds):
            return float(self.thresholds[last])
        # Halfway to what must be refused, so that neither side sits on the edge.
        return float(self.thresholds[last] + self.thresholds[last + 1]) / 2


def curve_of_drive(seen: Sequence[Sighting], rig: RigConfig, tolerance_m: float, length: int) -> Curve:
    """From sightings with known positions; a vehicle off the map's drives makes every match wrong."""
    left_m = np.array([one.ahead_m - rig.ahead_m(one.direction, one.order) for one in seen])
    uniqueness = np.array([one.uniqueness for one in seen])
    correct = np.abs(left_m) <= tolerance_m  # NaN is not
    curve = precision_recall(Answers(uniqueness, correct, np.ones(len(seen), dtype=bool)))
    accepted = np.array([(uniqueness >= threshold).sum() for threshold in curve.thresholds])
    return Curve(curve.thresholds, curve.precision, accepted, len(seen), len(seen) // length)


def curve_of_map(reference_map: ReferenceMap, config: Config) -> Curve:
    """From the map against itself without the surroundings of each place."""
    wrong = -np.sort([-uniqueness for uniqueness in _strangers(reference_map, config)])
    accepted = np.arange(1, len(wrong) + 1)
    return Curve(wrong, 1 - accepted / max(len(wrong), 1), accepted, len(wrong), len(wrong) // config.sequence.length)


def _strangers(reference_map: ReferenceMap, config: Config) -> Iterator[float]:
    """Uniqueness of the best match of each place where its own surroundings are missing."""
    header = reference_map.header
    map_set = MapSet.of(reference_map)
    (matcher,) = map_set.matchers
    missing = NO_LINE // (2 * config.sequence.length)  # no line through such a place is the best, and no sum runs over
    for segment in header.segments:
        # The camera that made the drive: with another's region orders its own reflection would be searched for.
        camera = msgspec.structs.replace(config.camera, view=segment.view)
        config = msgspec.structs.replace(config, camera=camera)
        part = Submap([(0, header.places)], map_set, config)
        for place in range(segment.start, segment.end):
            costs = matcher.costs_of_encoded(reference_map.descriptors[:, place : place + 1])
            # In the row, and not only among the ends of lines: one on the way back would cross the truth in its middle.
            costs[..., part.neighbourhood.around(place)] = missing
            match = part.advance(costs, replaces_ring=False)
            if match is None or match.distance * COST_ONE * config.sequence.length >= missing:
                continue
            alone = match.uniqueness * match.distance * COST_ONE * config.sequence.length >= missing
            yield 1.0 if alone else match.uniqueness
