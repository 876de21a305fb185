"""Raw descriptors of every traverse, each described once in a run and kept in memory; or read from files.

Keypoints put the best places of each frame in the order of their inliers: one frame, and no sequence.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from pathlib import Path
from time import process_time

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from edge.descriptor.network import Network, Regions, pictures_for, region_count
from edge.errors import ConfigError, FrameError
from edge.keypoints import Keypoints
from edge.keypoints.network import MOST, KeypointNetwork
from edge.recognition.recognizer import model_key
from edge.reference_map import ModelKey
from sim.compare.foreign import open_network
from sim.compare.matching import Matches
from sim.compare.plan import Plan
from sim.compare.traverses import MethodTraverse, open_pictures
from sim.compare.truth import read_array
from sim.evaluation.matched_points import verify

Raw = NDArray[np.float32]
MATRIX = 2


class Descriptions:
    """Describes traverses with the networks of a plan; paths of models are relative to `folder`, others to `data`."""

    def __init__(self, plan: Plan, folder: Path, data: Path) -> None:
        self._plan = plan
        self._folder = folder
        self._data = data
        self._opened: dict[str, Network] = {}
        self._raw: dict[tuple[object, ...], tuple[NDArray[np.intp], Raw, float]] = {}

    def network(self, name: str) -> Network:
        """A network, opened once."""
        if name not in self._opened:
            self._opened[name] = open_network(name, self._plan.networks[name], self._folder)
        return self._opened[name]

    def opened(self) -> dict[str, Network]:
        """Every network that was used, by its name in the plan."""
        return dict(self._opened)

    def model_key(self, name: str, dimensions: int) -> ModelKey:
        """What a map keeps of a network, or of descriptors (n, R, dimensions) that were made elsewhere."""
        if self._plan.networks[name].descriptors:
            return ModelKey(name, "0" * 64, "file", dimensions)
        return model_key(self.network(name))

    def raw(self, traverse: MethodTraverse, name: str, regions: Regions) -> Raw:
        """Descriptors (n, R, D) float32 of a traverse as the network gives them."""
        return self._made(traverse, name, regions)[0]

    def frame_ms(self, traverse: MethodTraverse, name: str, regions: Regions) -> float:
        """Milliseconds that a frame's description took, without reading its picture; NaN of files."""
        return self._made(traverse, name, regions)[1]

    def _made(self, traverse: MethodTraverse, name: str, regions: Regions) -> tuple[Raw, float]:
        if self._plan.networks[name].descriptors:
            return self._read(traverse, name)
        network = self.network(name)
        key = (name, network.info.sha256, regions, traverse.paths)
        # A traverse that ends earlier has the rows of the whole one.
        if key not in self._raw or not np.isin(traverse.rows, self._raw[key][0]).all():
            self._raw[key] = (traverse.rows, *self._described(traverse, network, regions))
        rows, raw, frame_ms = self._raw[key]
        return raw[np.searchsorted(rows, traverse.rows)], frame_ms

    def _read(self, traverse: MethodTraverse, name: str) -> tuple[Raw, float]:
        """Descriptors of a traverse that were made elsewhere. ConfigError names what is missing."""
        files = self._plan.networks[name].descriptors
        if traverse.name not in files:
            raise ConfigError(f"[networks.{name}]: descriptors: none of the traverse {traverse.name!r}")
        path = self._data / files[traverse.name]
        raw = read_array(path)
        raw = raw[:, np.newaxis] if raw.ndim == MATRIX else raw
        count = len(traverse.rows)
        if raw.dtype.kind != "f" or raw.ndim != MATRIX + 1 or len(raw) != count or not np.isfinite(raw).all():
            raise ConfigError(
                f"{path}: {raw.dtype} {raw.shape}; needs finite numbers, a row for each of the {count} frames of"
                f" {traverse.name}: ({count}, dimensions) or ({count}, regions, dimensions)"
            )
        return raw.astype(np.float32), float("nan")

    def _described(self, traverse: MethodTraverse, network: Network, regions: Regions) -> tuple[Raw, float]:
        """ConfigError names a picture that cannot be read."""
        shape = (len(traverse.rows), region_count(network.info, regions), network.info.dimensions)
        out, took_s = np.empty(shape, dtype=np.float32), 0.0
        images, width = open_pictures(traverse.feed), self._plan.region_width
        title = f"{traverse.name}: {network.info.output} {network.info.precision}, {regions}"
        try:
            for target, row in zip(out, tqdm(traverse.rows, desc=title, unit="frame", leave=False), strict=True):
                image, began_s = images.read(row), process_time()
                target[:] = network.describe(pictures_for(network.info, image, regions, width))
                took_s += process_time() - began_s
        except FrameError as error:
            raise ConfigError(f"traverses.{traverse.name}: {error}") from None
        finally:
            images.close()
        return out, 1e3 * took_s / len(out)


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
