"""The confidence from which a place is believed, for a precision that the user chooses.

From a drive: a match is right if, after the rig's offset, its place is within the tolerance of the vehicle.
From the map alone: each of its frames is matched to the map without the frame's surroundings. All such matches are
wrong, as those of a vehicle off the map, and the threshold rejects all but the allowed share of them. On six simulated
streets of 1 km the threshold for 99 % was 0.53 to 0.94, where other streets driven on those maps needed 0.75 to 0.93:
it may ask for more than the default, and is no reason to go below it. The map alone does not show how well places are
recognized in other light. If it has no positions and passes a place twice, it shows nothing: the other pass of the same
place is matched.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from edge.config import AcceptanceConfig, Config, RigConfig
from edge.errors import LookbackError
from edge.reference_map import COST_ONE, Drives, MapSet, ReferenceMap
from edge.sequence.consensus import ConsensusSettings, PlaceConsensus, PlaceVote
from edge.sequence.submap import Submap
from sim.calibration.offset_samples import OffsetSample
from sim.evaluation.metrics import Answers, precision_recall

DEFAULT = AcceptanceConfig().confidence_from


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


def curve_of_map(reference_map: ReferenceMap, config: Config) -> Curve:
    """From the map alone: each place matched without its surroundings."""
    wrong = -np.sort([-confidence for confidence in _confidence_off_map(reference_map, config)])
    accepted = np.arange(1, len(wrong) + 1)
    return Curve(wrong, 1 - accepted / max(len(wrong), 1), accepted, len(wrong), len(wrong) // config.sequence_frames)


def _confidence_off_map(reference_map: ReferenceMap, config: Config) -> Iterator[float]:
    """Confidence of what is believed at each place after its own surroundings were removed."""
    header = reference_map.header
    map_set = MapSet.of(reference_map)
    (matcher,) = map_set.matchers
    drives = Drives(map_set, config.sampling.spacing_m)
    settings = ConsensusSettings.of(config, drives)
    for segment in header.segments:
        # With the view of the segment's own camera: the region orders of the other would match its mirror image.
        camera = msgspec.structs.replace(config.camera, view=segment.view)
        config = msgspec.structs.replace(config, camera=camera)
        part = Submap([(0, header.places)], map_set, config, is_measured=drives.is_metric)
        consensus = PlaceConsensus(settings, drives.positions_m)
        for place in range(segment.start, segment.end):
            costs = matcher.costs_of_encoded(reference_map.descriptors[:, place : place + 1])
            # In the row, and not only at the ends of lines: a reverse line would cross the true place in its middle.
            costs[..., part.neighborhood.around(place)] = COST_ONE
            match = part.push(costs)
            vote = PlaceVote.of(match, drives, config.rig) if match is not None else None
            belief = consensus.update(vote, drives.along_m(place) if drives.is_metric else None)
            if match is not None:
                yield belief.confidence if belief is not None else 0.0
