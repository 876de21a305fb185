"""Miniatures of data sets are written here and in the tests, in exactly the published layouts."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from edge.errors import FeedError
from edge.geodesy import moved
from sim.datasets import ReadOptions, open_dataset
from sim.datasets.commands import add_arguments

WIDTH, HEIGHT = 64, 48
ORIGIN = (51.7600, -1.2600)


def picture(index: int) -> NDArray[np.uint8]:
    """A picture whose mean level tells its index, whatever a lossy codec makes of it."""
    return np.full((HEIGHT, WIDTH, 3), 10 + 6 * index, np.uint8)


@pytest.fixture
def index_of() -> Callable[[NDArray[np.uint8]], int]:
    return lambda image: round((float(image.mean()) - 10) / 6)


@pytest.fixture
def write_pictures() -> Callable[[Path, list[str]], None]:
    """Writes one picture a name, the first darkest."""

    def write(folder: Path, names: list[str]) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        for index, name in enumerate(names):
            assert cv2.imwrite(str(folder / name), picture(index))

    return write


@pytest.fixture
def write_video() -> Callable[[Path, int, float], None]:
    """Writes a video of so many pictures at that frame rate: MJPG in AVI, what every OpenCV build writes."""

    def write(file: Path, count: int, fps: float) -> None:
        file.parent.mkdir(parents=True, exist_ok=True)
        video = cv2.VideoWriter(str(file), cv2.VideoWriter.fourcc(*"MJPG"), fps, (WIDTH, HEIGHT))
        for index in range(count):
            video.write(picture(index))
        video.release()

    return write


@pytest.fixture
def degrees_at() -> Callable[[float, float], tuple[float, float]]:
    """Latitude and longitude of so many meters east and north of a corner of Oxford."""

    def degrees(east_m: float, north_m: float) -> tuple[float, float]:
        return moved(*ORIGIN, east_m, north_m)

    return degrees


@pytest.fixture
def sim_import() -> Callable[..., int]:
    """Runs `lookback import ...`."""

    def run(*argv: object) -> int:
        parser = argparse.ArgumentParser()
        add_arguments(parser)
        args = parser.parse_args([*map(str, argv)])
        return int(args.run(args))

    return run


@pytest.fixture
def refused() -> Callable[..., None]:
    """Sees that opening fails in one line with a message that matches."""

    def see(kind: str, path: Path, message: str, options: ReadOptions | None = None) -> None:
        with pytest.raises(FeedError, match=message) as raised:
            open_dataset(kind, path, options)
        assert "\n" not in str(raised.value)

    return see
