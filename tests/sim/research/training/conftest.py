"""Pictures of three classes that differ in pattern as well as in color, in folders."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

WriteClasses = Callable[..., Path]


def _picture(kind: int, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Fronts: upright stripes, red. Fields: level stripes, green. Crowds: spots, blue."""
    stripes = rng.integers(0, 2, 12).repeat(8)
    pattern = [np.tile(stripes, (96, 1)), np.tile(stripes[:, None], (1, 96)), rng.integers(0, 2, (96, 96))][kind]
    color = np.full(3, 60.0)
    color[2 - kind] = 200
    noisy = pattern[..., None] * color + rng.normal(20, 6, (96, 96, 3))
    return np.asarray(noisy.clip(0, 255), np.uint8)


@pytest.fixture
def write_classes(tmp_path: Path) -> WriteClasses:
    """write(pictures of each class) makes MiniPlaces' layout: a folder of letters, and in them folders of classes."""

    def write(count: int) -> Path:
        rng = np.random.default_rng(5)
        for kind, folder in enumerate(("c/crowd", "f/field", "f/front/shop")):
            (tmp_path / "images" / folder).mkdir(parents=True)
            for number in range(count):
                cv2.imwrite(str(tmp_path / "images" / folder / f"{number:08d}.png"), _picture(2 - kind, rng))
        return tmp_path / "images"

    return write
