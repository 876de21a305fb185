"""Fixtures that several folders of tests need."""

from __future__ import annotations

import struct
from collections import OrderedDict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from edge.camera.feed import FeedHeader, FeedWriter

SHARED = Path(__file__).parents[2] / "shared"


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of real recordings and float weights beside the checkout; what needs it is skipped without it."""
    if not SHARED.is_dir():
        pytest.skip(f"needs the real recordings in {SHARED.name}/ beside the checkout, which is not there")
    return SHARED


@pytest.fixture(scope="session")
def read_tlog(shared: Path) -> Callable[[str], Iterator[tuple[int, bytes]]]:
    """Yields (arrival in ns, one MAVLink 2 frame) of a real autopilot's recording, named without its suffix."""

    def read(name: str) -> Iterator[tuple[int, bytes]]:
        data = (shared / "autopilot" / f"{name}.tlog").read_bytes()
        at = 0
        while at + 20 <= len(data):
            (stamp_us,) = struct.unpack_from(">Q", data, at)
            size = 12 + data[at + 9] + 13 * (data[at + 10] & 1)
            yield stamp_us * 1000, data[at + 8 : at + 8 + size]
            at += 8 + size

    return read


@pytest.fixture
def torchvision_alexnet() -> Callable[[int, int], Any]:
    """Builds AlexNet in PyTorch as torchvision does, names of the weights included: (width of fc7, classes) -> module.

    torchvision.models.alexnet has an adaptive pool as well, which changes nothing at 224x224.
    """
    torch = pytest.importorskip("torch", reason="needs the extra `torch`")
    nn = torch.nn

    def build(hidden: int, classes: int) -> Any:
        features = nn.Sequential(
            *(nn.Conv2d(3, 64, 11, 4, 2), nn.ReLU(), nn.MaxPool2d(3, 2)),
            *(nn.Conv2d(64, 192, 5, 1, 2), nn.ReLU(), nn.MaxPool2d(3, 2)),
            *(nn.Conv2d(192, 384, 3, 1, 1), nn.ReLU()),
            *(nn.Conv2d(384, 256, 3, 1, 1), nn.ReLU()),
            *(nn.Conv2d(256, 256, 3, 1, 1), nn.ReLU(), nn.MaxPool2d(3, 2)),
        )
        classifier = nn.Sequential(
            *(nn.Dropout(), nn.Linear(9216, 4096), nn.ReLU()),
            *(nn.Dropout(), nn.Linear(4096, hidden), nn.ReLU(), nn.Linear(hidden, classes)),
        )
        parts = OrderedDict(features=features, flatten=nn.Flatten(), classifier=classifier)
        return nn.Sequential(parts).eval()

    return build


def _street(length_px: int) -> np.ndarray:
    """A long strip of coloured fronts with windows: every stretch of it looks like no other."""
    rng = np.random.default_rng(7)
    strip = np.full((120, length_px, 3), 200, dtype=np.uint8)
    at = 0
    while at < length_px:
        width, top = int(rng.integers(40, 110)), int(rng.integers(10, 70))
        cv2.rectangle(strip, (at, top), (at + width, 119), rng.integers(20, 235, 3).tolist(), -1)
        for _ in range(int(rng.integers(1, 7))):
            x, y = at + int(rng.integers(0, width)), int(rng.integers(top, 110))
            cv2.rectangle(strip, (x, y), (x + int(rng.integers(5, 25)), y + 12), rng.integers(0, 255, 3).tolist(), -1)
        at += width
    return strip


@pytest.fixture(scope="session")
def write_traverse() -> Callable[..., Path]:
    """Writes a feed that passes the fronts of one and the same street, 2 m and `period_ms` a frame."""
    strip = _street(160 + 12 * 80)

    def write(path: Path, frames: range = range(80), *, noise: float = 0.0, period_ms: int = 50) -> Path:
        rng = np.random.default_rng(1)
        with FeedWriter(path, FeedHeader(path.name, "front", 160, 120)) as writer:
            for row, frame in enumerate(frames):
                image = strip[:, 12 * frame : 12 * frame + 160] + rng.normal(0, noise, (120, 160, 3))
                writer.write(
                    image.clip(0, 255).astype(np.uint8),
                    row * period_ms * 1_000_000,
                    lat_deg=-27.0 + frame * 2 / 110_800,
                    lon_deg=153.0,
                    heading_deg=0.0,
                    distance_m=row * 2.0,
                )
        return path

    return write
