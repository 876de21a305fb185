"""Miniature feeds: a street of colored stripes that two drives see in other light."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.feed import FeedHeader, FeedRow
from edge.feed.writer import FeedWriter

WIDTH, HEIGHT = 64, 48
THERE_M, HERE_M = [2.0 * step for step in range(16)], [4.0 + 2.0 * step for step in range(12)]
PAIR = """
[[pairs]]
name = "there and here"
reference = "there"
query = "here"
truth = "positions"
tolerance = 3.0
length = 4
"""
METER_DEG = 1 / 110_574  # of latitude at the equator
WriteFeed = Callable[..., Path]


def street(route_m: float, light: float, rng: np.random.Generator) -> NDArray[np.uint8]:
    """What is to be seen at one place: a window of a fixed random wall, in some light, with some noise."""
    wall = np.random.default_rng(7).integers(0, 255, (HEIGHT // 8, 400, 3)).astype(np.float64)
    left = round(route_m)
    seen = wall[:, left : left + WIDTH // 4].repeat(8, axis=0).repeat(4, axis=1)
    noisy = seen * light + rng.normal(0, 6, seen.shape)
    return np.asarray(noisy.clip(0, 255), dtype=np.uint8)


@pytest.fixture
def write_feed(tmp_path: Path) -> WriteFeed:
    """write(name, places in meters along the route, view, light, sees_m) makes a feed in the test's folder.

    sees_m: how far along the route what a picture shows lies beyond where it was taken.
    """

    def write(
        name: str,
        route_m: list[float],
        view: Literal["front", "rear"] = "front",
        light: float = 1.0,
        sees_m: float = 0.0,
    ) -> Path:
        rng = np.random.default_rng(len(name))
        path = tmp_path / name
        with FeedWriter(path, FeedHeader(name, view, WIDTH, HEIGHT), extra_columns=("route_m",)) as writer:
            covered = np.abs(np.diff(route_m, prepend=route_m[0])).cumsum().tolist()
            for index, (at_m, covered_m) in enumerate(zip(route_m, covered, strict=True)):
                writer.write(
                    street(at_m + sees_m, light, rng),
                    FeedRow(
                        "",
                        index * 500_000_000,
                        lat_deg=at_m * METER_DEG,
                        lon_deg=0.0,
                        distance_m=covered_m,
                        extra={"route_m": str(at_m)},
                    ),
                )
        return path

    return write


@pytest.fixture
def write_plan(tmp_path: Path, write_feed: WriteFeed) -> Callable[[str], Path]:
    """write(the lines of a plan before its one pair) makes the plan `there` and `here`, and their feeds."""

    def write(first: str) -> Path:
        write_feed("there", THERE_M)
        write_feed("here", HERE_M, light=0.5)
        path = tmp_path / "plan.toml"
        path.write_text(f"{first}\n{PAIR}")
        return path

    return write
