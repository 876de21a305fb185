"""Two drives over one road that disagree about where it is: found and named."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from edge.__main__ import main
from edge.config import SamplingConfig
from edge.geodesy import PositionSource, moved
from edge.reference_map import open_map, open_map_set
from edge.reference_map.store import ModelKey, RegionsKey
from edge_plugins.mapping.builder import NAN, MapBuilder, Place
from sim.maps.agreement import LENGTH, disagreements
from sim.maps.tiles import split_map

MODEL = ModelKey("test", "0" * 64, "fc6", 64)
PLACES, SPACING_M = 200, 2.0


@dataclass(frozen=True)
class Placed:
    """A drive north over a road, places [start, end) of it, recorded east of the truth by `east_m`."""

    east_m: float = 0.0
    north_m: float = 0.0
    sigma_m: float = 1.0
    view: Literal["front", "rear"] = "rear"
    back: bool = False
    road: int = 0
    start: int = 0
    end: int = PLACES
    wrong_from: int = 0
    """Places of the road from there on are recorded so; those before, at the truth."""
    mirrored: bool = False
    """Whether each window looks like the road does backwards."""


def build(path: Path, drives: Sequence[Placed]) -> None:
    with MapBuilder(path, MODEL, RegionsKey("left-right", 0.4), SamplingConfig()) as builder:
        for number, drive in enumerate(drives):
            rng = np.random.default_rng(drive.road)
            road = np.maximum(rng.normal(size=(PLACES, 2, 64)), 0)
            seen = np.maximum(road + 0.4 * np.random.default_rng([number, 7]).normal(size=road.shape), 0)
            if drive.mirrored:
                seen = seen.reshape(-1, LENGTH, 2, 64)[:, ::-1].reshape(seen.shape)
            builder.begin_segment(f"drive {number}", drive.view)
            rows = list(range(drive.start, drive.end))[:: -1 if drive.back else 1]
            for row, at in enumerate(rows):
                off_m = (drive.east_m, drive.north_m) if at >= drive.wrong_from else (0.0, 0.0)
                lat_deg, lon_deg = moved(-27.0, 153.0, off_m[0], off_m[1] + at * SPACING_M)
                source: PositionSource = "unknown" if np.isnan(drive.sigma_m) else "gps"
                known = Place(
                    row, lat_deg, lon_deg, 0.0, 180.0 * drive.back, row * SPACING_M, b"", drive.sigma_m, source
                )
                builder.add(seen[at].astype(np.float32), known)
        builder.finish()


@pytest.mark.parametrize(
    ("second", "apart_m"),
    [
        (Placed(east_m=40.0), 40.0),
        (Placed(north_m=40.0), 40.0),
        (Placed(east_m=8.0), 8.0),
        (Placed(north_m=-8.0), 8.0),
        (Placed(north_m=28.3, east_m=28.3, view="front", back=True), 40.0),
        (Placed(east_m=40.0, start=60, end=160), 40.0),
    ],
)
def test_drives_that_are_apart_by_more_than_their_accuracy_are_found(
    second: Placed, apart_m: float, tmp_path: Path
) -> None:
    build(tmp_path / "map", [Placed(), second])
    (found,) = disagreements(open_map_set(tmp_path / "map"))
    assert found.apart_m == pytest.approx(apart_m, abs=2.0)


@pytest.mark.parametrize(
    "second",
    [
        Placed(),
        Placed(east_m=3.5),
        Placed(east_m=8.0, sigma_m=NAN),
        Placed(east_m=8.0, sigma_m=4.0),
        Placed(east_m=8.0, view="front", back=True),
        Placed(east_m=40.0, road=1),
        Placed(east_m=40.0, view="front"),
        Placed(east_m=40.0, view="front", mirrored=True),
        Placed(east_m=40.0, end=50),
    ],
    ids=[
        "right",
        "another lane",
        "accuracy not recorded",
        "as inaccurate",
        "lanes of both directions",
        "another road beside it",
        "what the cameras saw lies apart",
        "a line that leads against the road",
        "too short",
    ],
)
def test_what_the_accuracy_explains_and_what_cannot_be_compared_is_none(second: Placed, tmp_path: Path) -> None:
    build(tmp_path / "map", [Placed(), second])
    assert disagreements(open_map_set(tmp_path / "map")) == []


def test_only_the_stretch_where_they_disagree_is_named(tmp_path: Path) -> None:
    build(tmp_path / "map", [Placed(), Placed(east_m=40.0, wrong_from=100)])
    (found,) = disagreements(open_map_set(tmp_path / "map"))
    (_, first, end), (_, second, second_end) = found.stretches
    assert (end, second_end) == (200, 400)
    assert [first, second] == pytest.approx([100, 300], abs=20)


def test_drives_in_several_maps_and_tiles_are_compared(tmp_path: Path) -> None:
    build(tmp_path / "maps" / "a", [Placed()])
    build(tmp_path / "maps" / "b", [Placed(east_m=40.0)])
    maps = open_map_set(tmp_path / "maps")
    (found,) = disagreements(maps)
    assert [path.name for path, _, _ in found.stretches] == ["a", "b"]
    build(tmp_path / "whole", [Placed(), Placed(east_m=40.0)])
    split_map(open_map(tmp_path / "whole"), tmp_path / "tiles", 150)
    assert disagreements(open_map_set(tmp_path / "tiles"))


def test_a_drive_without_positions_agrees_with_everything(tmp_path: Path) -> None:
    build(tmp_path / "map", [Placed(), Placed(east_m=NAN)])
    assert disagreements(open_map_set(tmp_path / "map")) == []


def test_verify_names_both_stretches_and_fails(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    build(tmp_path / "map", [Placed(), Placed(east_m=40.0)])
    assert main(["map", "verify", str(tmp_path / "map")]) == 1
    said = capsys.readouterr().out
    assert "all 5 checksums match" in said
    assert "places 0 to 199 of map and 200 to 399 of map show the same road 40 m apart" in said
