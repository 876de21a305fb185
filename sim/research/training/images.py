"""A folder of pictures for each class, read into one array."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.errors import ConfigError, FrameError
from edge.feed import read_picture
from sim.datasets.pictures import PICTURE_SUFFIXES, list_pictures

Progress = Callable[[Iterable[NDArray[np.uint8]]], Iterable[NDArray[np.uint8]]]


@dataclass(frozen=True)
class LabeledImages:
    """pixels: (N, side, side, 3) uint8 RGB. labels: (N,) int64, each an index into classes."""

    pixels: NDArray[np.uint8]
    labels: NDArray[np.int64]
    classes: tuple[str, ...]

    def split(self, held_out_share: float) -> tuple[LabeledImages, LabeledImages]:
        """(to learn from, held out): every so many-th picture is held out, so that all classes lose alike."""
        held_out = np.zeros(len(self.labels), bool)
        held_out[:: round(1 / held_out_share)] = True
        learned, kept = (LabeledImages(self.pixels[at], self.labels[at], self.classes) for at in (~held_out, held_out))
        return learned, kept


def find_classes(folder: Path) -> dict[str, list[Path]]:
    """Picture files by class: every folder below `folder` that has pictures is a class, named by its path.

    The single letters into which Places and MiniPlaces sort their classes (a/abbey) are left out of the names.
    ConfigError for fewer than 2 classes; FeedError names a folder at the end of a path that has no pictures.
    """
    if not folder.is_dir():
        raise ConfigError(f"{folder}: no such folder; give one with a folder of pictures for each class")
    classes: dict[str, list[Path]] = {}
    for below in sorted(path for path in folder.rglob("*") if path.is_dir()):
        has_folders = any(path.is_dir() for path in below.iterdir())
        if has_folders and not any(path.suffix.lower() in PICTURE_SUFFIXES for path in below.iterdir()):
            continue
        name = re.sub(r"^\w/", "", below.relative_to(folder).as_posix())
        if name in classes:
            raise ConfigError(f"{below}: a second folder of the class {name}; the first is {classes[name][0].parent}")
        classes[name] = [below / file for file in list_pictures(below)]
    if len(classes) < 2:
        raise ConfigError(f"{folder}: {len(classes)} class(es); needs a folder of pictures for each of at least 2")
    return classes


def read_images(classes: dict[str, list[Path]], side_px: int, progress: Progress) -> LabeledImages:
    """All pictures, squeezed to squares as the network will see whole frames; ConfigError names an unreadable one.

    Takes 3 side_px^2 bytes a picture: 4.9 GB for the 100,000 of MiniPlaces at 128.
    """
    files = [file for of_class in classes.values() for file in of_class]
    pixels = np.empty((len(files), side_px, side_px, 3), np.uint8)
    with ThreadPoolExecutor() as pool:  # OpenCV lets go of the interpreter while it decodes
        try:
            for row, image in enumerate(progress(pool.map(lambda file: _read_square(file, side_px), files))):
                pixels[row] = image
        except FrameError as error:
            pool.shutdown(cancel_futures=True)
            raise ConfigError(f"{error}; remove it, or put a whole one there") from None
    counts = [len(of_class) for of_class in classes.values()]
    return LabeledImages(pixels, np.repeat(np.arange(len(counts)), counts), tuple(classes))


def _read_square(file: Path, side_px: int) -> NDArray[np.uint8]:
    image = cv2.resize(read_picture(file), (side_px, side_px), interpolation=cv2.INTER_AREA)
    return np.asarray(image[..., ::-1], np.uint8)
