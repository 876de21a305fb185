"""What this processor answers: `python processor_answers.py DRIVES.npz ANSWERS.npz`.

DRIVES has raw descriptors (n, R, D) of a mapped drive, `road`, and of a drive over it, `home`, every SPACING_M, and
`pictures` (n, H, W, 3) uint8 to describe: few, since one takes an emulated Haswell 30 s (float convolutions).
test_processors.py runs this file on other processors too, whose Python has only what a vehicle needs.
"""

from __future__ import annotations

import hashlib
import sys

import numpy as np
from numpy.typing import NDArray

from edge.config import Config, SamplingConfig, SequenceConfig
from edge.descriptor.model_file import GRID, read_model_file
from edge.descriptor.network import IMAGE, Network, cut_regions, open_session, pictures_for
from edge.descriptor.open_network import normalized_set
from edge.keypoints.network import KeypointNetwork
from edge.recognition.sequence_matcher import SequenceMatcher
from edge.reference_map import ModelKey
from edge.reference_map.costs import CostMatcher, encode
from edge.sequence import MotionPrior
from edge_plugins.mapping.builder import Place
from sim.compare.temporary_map import MappedDrive, temporary_map

SPACING_M = 4.0
SEQUENCE = 20
"""Frames: 80 m of road."""


def print_exact() -> None:
    """Hashes of what has the same bytes everywhere: regions, fc6, and costs of descriptors."""
    rng = np.random.default_rng(3)
    soft = np.cumsum(rng.integers(-9, 10, (480, 640, 3)), axis=1) % 256
    harsh = rng.integers(0, 2, (1080, 1920, 3)) * 255  # black and white at random: the largest sums
    network = Network.load()
    raw = []
    for image in (soft, harsh):
        regions = cut_regions(image.astype(np.uint8), "left-right", 0.4, (224, 224))
        raw.append(network.describe(regions))
        print("regions", hashlib.sha256(regions.tobytes()).hexdigest())
        print("fc6", hashlib.sha256(raw[-1].tobytes()).hexdigest())
    costs = CostMatcher.of_encoded(encode(np.stack(raw))).costs(np.stack(raw))
    print("costs", hashlib.sha256(costs.tobytes()).hexdigest())


def by_grid(pictures: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Raw descriptors (n, R, D) of pictures (n, H, W, 3), without the two runs by which Network tries a file."""
    file = read_model_file(GRID)
    session = open_session(file.data)
    given = (pictures_for(file.info, one, "left-right", 0.4) for one in pictures)
    return np.concatenate([session.run(None, {IMAGE: one})[0] for one in given])


def costs_of(road: NDArray[np.float32], home: NDArray[np.float32]) -> NDArray[np.int32]:
    """Costs (n, orders, N) of the frames of a drive to the places of a map, both raw descriptors (n, R, D)."""
    return CostMatcher.of_encoded(encode(normalized_set(road))).costs(normalized_set(home))


def matched(road: NDArray[np.float32], home: NDArray[np.float32]) -> NDArray[np.float64]:
    """Of each frame (n, 4): best place, believed place, whether believed, confidence; -1, -1, 0, 0 where none is."""
    config = Config(sampling=SamplingConfig(spacing_m=SPACING_M), sequence=SequenceConfig(length=SEQUENCE))
    places = [Place(row, route_m=SPACING_M * row) for row in range(len(road))]
    key, found = ModelKey("grid", "0" * 64, "grid", road.shape[2]), []
    with temporary_map([MappedDrive(road, places, "rear")], key) as maps:
        matcher = SequenceMatcher(maps, config)
        for frame, raw in enumerate(home):
            match = matcher.push(raw, MotionPrior(SPACING_M * frame))
            if match is None or matcher.best is None:
                found.append((-1.0, -1.0, 0.0, 0.0))
            else:
                found.append((matcher.best.place_index, match.place_index, match.accepted, match.confidence))
    return np.array(found, np.float64)


def main() -> None:
    """Describe the pictures by the grid, search with the descriptors that are given, and print what is exact."""
    drives = np.load(sys.argv[1])
    road, home = drives["road"], drives["home"]
    found = KeypointNetwork().extract(drives["pictures"][0])
    np.savez(
        sys.argv[2],
        raw=by_grid(drives["pictures"]),
        costs=costs_of(road, home),
        matched=matched(road, home),
        xy=found.xy,
        scores=found.scores,
        descriptors=found.descriptors,
    )
    print_exact()


if __name__ == "__main__":
    main()
