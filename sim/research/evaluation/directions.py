"""The directions of fc6 along which places differ, and one place in another light or from behind does not.

    python -m sim.research.evaluation.directions --seeds 5102 5203 6101 6202 --cache FOLDER -o directions.npy
    python -m sim.research.evaluation.belief --seeds 5405 5506 --length 800 --cache FOLDER --directions directions.npy

They are learned from pairs on simulated roads: a place of a rear camera's map by day, and the frame of a front camera
that shows the same. Kept are those in which pairs agree most, against how much they differ (Fisher's discriminant, with
shrinkage). A map is then matched along its own principal directions and these ones. No map that `lookback` builds is:
docs/evaluation.md says what was measured. Descriptors are kept in FOLDER, as `belief` has them.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edge.descriptor.network import Network
from edge.descriptor.normalize import normalize
from edge.sequence import Direction
from sim.maps.shrinking import principal_directions
from sim.research.evaluation.belief import Described, described
from sim.research.evaluation.learned_map import carried, regions
from sim.world.scenario import LightName, Scenario

DRIVES: tuple[tuple[LightName, Direction, int], ...] = (
    ("dusk", "forward", 4),
    ("night", "reverse", 3),
    ("snow", "forward", 8),
    ("snow", "reverse", 9),
)
"""Light, direction, and drive seed as `belief` counts them, so that the two share their cached drives."""
AHEAD_M = 30.0
"""By how much what a front camera sees the same way lies ahead of what a rear camera saw: medians of 26 to 38 m."""
BESIDE_M = {"forward": (-6.0, 0.0, 6.0), "reverse": (-3.0, 0.0, 3.0)}
"""Each frame makes pairs with places beside its own as well, since nobody knows better where its own is."""
NEAR_M = 2.0
FOLLOWED = 1024
"""Principal directions within which pairs are looked at: .86 of the variance."""
SHRINKAGE = 0.1
"""Of the covariance within pairs, toward its mean. R@P100 by these directions alone: .985 with .3, .964 with 3."""
Rows = NDArray[np.float32]


@dataclass(frozen=True)
class Examples:
    """Normalized rows (n, D) of single regions, and pairs of them (m, D) that show the same."""

    rows: Rows
    seen: Rows
    mapped: Rows


def examples(road: Described, drives: dict[str, Described]) -> Examples:
    """Of one road as its map has it, and of drives on it by direction and light ("forward dusk")."""
    mapped = _by_set(road.raw)
    rows, seen, same = [regions(mapped)], [], []
    for name, drive in drives.items():
        way = name.partition(" ")[0]
        own = _by_set(drive.raw)
        rows.append(regions(own))
        # The same way, a front camera sees at its left what a rear camera saw at its right.
        own = own[:, ::-1] if way == "forward" else own
        for beside_m in BESIDE_M[way]:
            expected_m = drive.route_m + (AHEAD_M if way == "forward" else 0.0) + beside_m
            apart_m = np.abs(road.route_m - expected_m[:, np.newaxis])
            known = apart_m.min(axis=1) < NEAR_M
            seen.append(regions(own[known]))
            same.append(regions(mapped[apart_m.argmin(axis=1)[known]]))
    return Examples(np.concatenate(rows), np.concatenate(seen), np.concatenate(same))


def learn(found: Examples, kept: int) -> Rows:
    """Directions (kept, D), each as long as pairs agree along it; together they carry as much as one dimension."""
    dimensions = found.rows.shape[1]
    followed = min(FOLLOWED, dimensions)
    basis = principal_directions(lambda: iter([found.rows]), dimensions, followed)
    seen, mapped = ((rows @ basis.T).astype(np.float64) for rows in (found.seen, found.mapped))
    within = (seen - mapped).T @ (seen - mapped) / (2 * len(seen))
    between = (seen.T @ mapped + mapped.T @ seen) / (2 * len(seen))
    within += SHRINKAGE * np.trace(within) / followed * np.eye(followed)
    values, vectors = np.linalg.eigh(within)
    whitening = vectors / np.sqrt(values)
    agreements, turn = np.linalg.eigh(whitening.T @ between @ whitening)
    agreements, turn = agreements[::-1][:kept], turn[:, ::-1][:, :kept]
    directions = (whitening @ turn * np.sqrt(np.maximum(agreements, 0))).T.astype(np.float32) @ basis
    return np.asarray(directions / carried([found.rows], directions), dtype=np.float32)


def _by_set(raw: Rows) -> Rows:
    """Normalized over its own set, as a map is."""
    whole = raw.astype(np.float64)
    return normalize(raw, whole.mean(axis=0), whole.std(axis=0))


def _roads(seeds: list[int], length_m: float, network: Network, cache: Path) -> Iterator[Examples]:
    for seed in seeds:
        scene = partial(Scenario, seed=seed, length_m=length_m)
        road = described(scene(view="rear", drive_seed=1), network, cache)
        drives = {}
        for light, way, drive_seed in DRIVES:
            seen = scene(light=light, direction=way, drive_seed=drive_seed)
            drives[f"{way} {light}"] = described(seen, network, cache)
        yield examples(road, drives)


def main() -> None:
    """Render the roads of the seeds, unless they are in the cache, and write what is learned from them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", required=True)
    parser.add_argument("--cache", type=Path, required=True)
    parser.add_argument("--length", type=float, default=800.0, help="of each road, m")
    parser.add_argument("--kept", type=int, default=256, help="directions")
    parser.add_argument("-o", "--output", type=Path, required=True)
    args = parser.parse_args()
    args.cache.mkdir(parents=True, exist_ok=True)
    network = Network.load()
    roads = list(_roads(args.seeds, args.length, network, args.cache))
    found = Examples(*(np.concatenate([getattr(road, name) for road in roads]) for name in ("rows", "seen", "mapped")))
    print(f"{len(found.rows)} regions, {len(found.seen)} pairs")
    np.save(args.output, learn(found, args.kept))


if __name__ == "__main__":
    main()
