"""Drives over one straight road as maps of a folder, small."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from edge.config import SamplingConfig
from edge.geodesy import moved
from edge.reference_map import ModelKey, RegionsKey
from edge_plugins.mapping.builder import MapBuilder, Place

MODEL, DIMENSIONS = ModelKey("test", "0" * 64, "fc6", 32), 32
SPACING_M = 2.0
MADE_S = 1_790_000_000.0


@dataclass(frozen=True)
class Driven:
    """A drive north over places [start, end) of a road, in one of some lights, none of which is like another."""

    light: int = 0
    view: Literal["front", "rear"] = "front"
    start: int = 0
    end: int = 200
    made_s: float = MADE_S
    is_placed: bool = True
    back: bool = False


def build(path: Path, drive: Driven) -> Path:
    """The map of a drive. The noise of each is its own."""
    road = np.random.default_rng(7).normal(size=(400, 2, DIMENSIONS))
    light = np.random.default_rng([drive.light, 8]).normal(size=(400, 2, DIMENSIONS))
    noise = np.random.default_rng(sum(map(ord, path.name))).normal(size=(400, 2, DIMENSIONS))
    seen = (road + light + 0.3 * noise).astype(np.float32)
    with MapBuilder(path, MODEL, RegionsKey("left-right", 0.4, "set"), SamplingConfig()) as builder:
        builder.begin_segment(f"drive of {path.name}", drive.view)
        rows = list(range(drive.start, drive.end))[:: -1 if drive.back else 1]
        for row, at in enumerate(rows):
            lat_deg, lon_deg = moved(-27.0, 153.0, 0.0, at * SPACING_M) if drive.is_placed else (np.nan, np.nan)
            heading_deg = 180.0 * drive.back
            where = row, lat_deg, lon_deg, 0.0, heading_deg, row * SPACING_M
            builder.add(seen[at], Place(*where, position_sigma_m=1.5, position_source="gps"))
        builder.finish()
    os.utime(path / "map.json", (drive.made_s, drive.made_s))
    return path
