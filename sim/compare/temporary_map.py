"""A map of descriptors that are in memory, for the recognizer's own matcher."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edge.config import SamplingConfig
from edge.descriptor.network import Regions
from edge.feed import View
from edge.reference_map import MapSet, ModelKey
from edge.reference_map.store import RegionsKey, open_map
from edge_plugins.mapping.builder import MapBuilder, Place


@dataclass(frozen=True)
class MappedDrive:
    """Raw descriptors (n, R, D) of a drive, its n places, and where the camera faced."""

    raw: NDArray[np.float32]
    places: list[Place]
    view: View


@contextmanager
def temporary_map(drives: Sequence[MappedDrive], model: ModelKey) -> Iterator[MapSet]:
    """A map with a segment for each drive, of one region or two, which is gone when the block ends."""
    kind: Regions = "left-right" if drives[0].raw.shape[1] > 1 else "whole"
    with tempfile.TemporaryDirectory() as folder:
        path, regions = Path(folder) / "map", RegionsKey(kind, 0.4)
        with MapBuilder(path, model, regions, SamplingConfig()) as builder:
            for number, drive in enumerate(drives):
                builder.begin_segment(str(number), drive.view)
                for raw, place in zip(drive.raw, drive.places, strict=True):
                    builder.add(raw, place)
            builder.finish()
        yield MapSet.of(open_map(path))
