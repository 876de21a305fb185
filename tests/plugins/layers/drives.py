"""Drives over one straight road as maps of a folder, small."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from edge.geodesy import moved
from edge.reference_map import ModelKey
from edge_plugins.mapping.builder import Place
from tests.map_of import map_of

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
    rows, places = list(range(drive.start, drive.end))[:: -1 if drive.back else 1], []
    for row, at in enumerate(rows):
        lat_deg, lon_deg = moved(-27.0, 153.0, 0.0, at * SPACING_M) if drive.is_placed else (np.nan, np.nan)
        where = row, lat_deg, lon_deg, 0.0, 180.0 * drive.back, row * SPACING_M
        places.append(Place(*where, position_sigma_m=1.5, position_source="gps"))
    map_of(path, seen[rows], places, view=drive.view)
    os.utime(path / "map.json", (drive.made_s, drive.made_s))
    return path
