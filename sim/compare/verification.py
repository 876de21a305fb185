"""The best places of each frame in the order of their inliers: one frame, and no sequence."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from time import process_time

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from edge.keypoints import Keypoints
from edge.keypoints.network import MOST, KeypointNetwork
from sim.compare.matching import Matches
from sim.compare.traverses import MethodTraverse, open_pictures
from sim.evaluation.matched_points import verify


class Verification:
    """The keypoints of traverses, found once in a run and kept in memory."""

    def __init__(self) -> None:
        self._found: dict[tuple[object, ...], tuple[list[Keypoints], float]] = {}

    @cached_property
    def _network(self) -> KeypointNetwork:
        return KeypointNetwork()

    def keypoints(self, traverse: MethodTraverse) -> list[Keypoints]:
        """Of each frame, at most MOST."""
        return self._of(traverse)[0]

    def frame_ms(self, traverse: MethodTraverse) -> float:
        """Milliseconds that the keypoints of a frame took, without reading its picture."""
        return self._of(traverse)[1]

    def _of(self, traverse: MethodTraverse) -> tuple[list[Keypoints], float]:
        key = (traverse.paths, traverse.rows.tobytes())
        if key not in self._found:
            images, found, took_s = open_pictures(traverse.feed), [], 0.0
            for row in tqdm(traverse.rows, desc=f"{traverse.name}: keypoints", unit="frame", leave=False):
                image, began_s = images.read(row), process_time()
                found.append(self._network.extract(image))
                took_s += process_time() - began_s
            images.close()
            self._found[key] = found, 1e3 * took_s / len(found)
        return self._found[key]

    def reordered(
        self, matches: Matches, reference: MethodTraverse, query: MethodTraverse, most: int = MOST
    ) -> Matches:
        """The ranked places by the inliers of each with the frame's `most` keypoints, which are the confidence.

        Of as many inliers, the place that was ranked first stays first.
        """
        places, frames = ([_best(one, most) for one in self.keypoints(each)] for each in (reference, query))
        inliers = np.full(matches.ranked.shape, -1)
        for frame, ranked in enumerate(matches.ranked):
            for rank, place in enumerate(ranked[ranked >= 0]):
                inliers[frame, rank] = verify(frames[frame], places[place]).inliers
        order: NDArray[np.intp] = np.argsort(-inliers, axis=1, kind="stable")
        ranked = np.take_along_axis(matches.ranked, order, axis=1)
        inliers = np.take_along_axis(inliers, order, axis=1)
        ranking, (query_of, rank_of) = np.full_like(matches.costs, np.inf), np.nonzero(ranked >= 0)
        ranking[query_of, ranked[query_of, rank_of]] = rank_of

        def inliers_in(query: int, place: int) -> float:
            return float(inliers[query, int(ranking[query, place])])

        place, confidence = ranked[:, 0], inliers[:, 0].astype(np.float64)
        return replace(matches, place=place, confidence=confidence, ranking=ranking, confidence_of=inliers_in)


def _best(points: Keypoints, most: int) -> Keypoints:
    """The first `most` of them."""
    return Keypoints(points.xy[:most], points.scores[:most], points.descriptors[:most], points.size)
