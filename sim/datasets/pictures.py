"""Pictures in folders and videos, in the order they were taken."""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import accumulate
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.errors import FeedError, FrameError
from edge.feed import Feed, FeedHeader, FeedImages, FeedRow, Pictures, read_feed, read_picture
from sim.output import needing, refusing

HEIF_SUFFIXES = frozenset({".heic", ".heif"})
PICTURE_SUFFIXES = frozenset({".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff"}) | HEIF_SUFFIXES
VIDEO_SUFFIXES = frozenset({".mp4", ".avi", ".mkv", ".mov", ".m4v", ".webm"})


class PictureFiles:
    """A picture a file, in color, with what the data set needs done to it."""

    def __init__(
        self,
        files: Sequence[Path],
        develop: Callable[[NDArray[np.uint8]], NDArray[np.uint8]] | None = None,
        flags: int = cv2.IMREAD_COLOR,
    ) -> None:
        """develop: from what OpenCV reads with `flags` to (H, W, 3) uint8 BGR."""
        self._files = files
        self._develop = develop
        self._flags = flags

    def read(self, index: int) -> NDArray[np.uint8]:
        """Picture `index`, (H, W, 3) uint8 BGR; FrameError names the file."""
        file = self._files[index]
        image = read_heif(file) if file.suffix.lower() in HEIF_SUFFIXES else read_picture(file, self._flags)
        return self._develop(image) if self._develop else image

    def close(self) -> None:
        """Nothing is kept open."""


def read_heif(file: Path) -> NDArray[np.uint8]:
    """A phone's picture, upright, (H, W, 3) uint8 BGR; FrameError names the file."""
    know_heif(file)
    from PIL import Image

    try:
        with Image.open(file) as image:
            return np.ascontiguousarray(np.asarray(image.convert("RGB"))[..., ::-1])
    except (OSError, ValueError) as error:
        raise FrameError(f"{file}: cannot read this picture: {error}") from None


def know_heif(file: Path) -> None:
    """Let Pillow open HEIF files, if the file is one. FeedError where the package for them is missing."""
    if file.suffix.lower() in HEIF_SUFFIXES:
        with needing(str(file), "import", FeedError):
            from pi_heif import register_heif_opener
        register_heif_opener()


class JoinedPictures:
    """The pictures of several recordings, one after the other; they may differ in size."""

    def __init__(self, parts: Sequence[Pictures], counts: Iterable[int]) -> None:
        """counts: how many each has."""
        self._parts = parts
        self._starts = [0, *accumulate(counts)]

    def read(self, index: int) -> NDArray[np.uint8]:
        """Picture `index` of all; FrameError names the file."""
        part = bisect_right(self._starts, index) - 1
        return self._parts[part].read(index - self._starts[part])

    def close(self) -> None:
        """Release the files."""
        for part in self._parts:
            part.close()


class PicturesInOrder:
    """The pictures of a recording that is read from its beginning on; going back starts again there."""

    def __init__(
        self, what: str, messages: Callable[[], Iterator[Any]], develop: Callable[[str, Any], NDArray[np.uint8]]
    ) -> None:
        """messages: opens the recording, one message a picture. develop: makes an image of one; its name is first."""
        self._what, self._open, self._develop = what, messages, develop
        self.close()

    def message(self, index: int) -> Any:
        """That of picture `index` as it was recorded. FrameError where there is none."""
        if index < self._next:
            self.close()
        for message in self._messages:
            self._next += 1
            if self._next > index:
                return message
        raise FrameError(f"{self._what}: no picture {index}")

    def read(self, index: int) -> NDArray[np.uint8]:
        """Picture `index`, (H, W, 3) uint8 BGR; FrameError names it."""
        return self._develop(f"{self._what}: picture {index}", self.message(index))

    def close(self) -> None:
        """Close the recording; more than once is harmless."""
        self._messages, self._next = self._open(), 0


def list_pictures(folder: Path) -> list[str]:
    """Names of the picture files in a folder, numbers in their numeric order; FeedError if there are none."""
    with refusing(FeedError, f"{folder}: cannot read this folder"):
        names = [entry.name for entry in folder.iterdir() if entry.suffix.lower() in PICTURE_SUFFIXES]
    if not names:
        raise FeedError(f"{folder}: no pictures in this folder")
    return sorted(names, key=natural_key)


def read_drive(path: Path) -> Feed:
    """A recording; or a folder of pictures that is no feed, in the order of their names. FeedError."""
    if not path.is_dir() or (path / "feed.toml").exists():
        return read_feed(path)
    files = [path / name for name in list_pictures(path)]
    height, width = PictureFiles(files).read(0).shape[:2]
    rows = tuple(FeedRow(file.name, number * 10**9) for number, file in enumerate(files))
    return Feed(path, FeedHeader(path.name, "front", width, height), rows, lambda: PictureFiles(files))


def natural_key(name: str) -> list[tuple[str, int]]:
    """Sorts Image9 before Image10."""
    return [(text, int(number or 0)) for text, number in re.findall(r"(\D*)(\d*)", name)]


def number_in(name: str, otherwise: int) -> int:
    """The last number in a file's name: 7 of images-00007.png."""
    numbers = re.findall(r"\d+", Path(name).stem)
    return int(numbers[-1]) if numbers else otherwise


def open_video(file: Path) -> tuple[Feed, Pictures]:
    """A video's frames with their stamps from its frame rate, and its pictures. FeedError names the file."""
    if not file.is_file():
        raise FeedError(f"{file}: no such video")
    feed = read_feed(file)
    return feed, FeedImages(feed)


def frames_of(path: Path, fps: float) -> tuple[list[str], list[int], Pictures]:
    """Frames of a folder, `fps` a second, or of a video, at its own rate: names, stamps in ns, and pictures.

    A frame of a video is named by its number. FeedError if there are none.
    """
    if path.suffix.lower() in VIDEO_SUFFIXES:
        feed, pictures = open_video(path)
        return [str(index) for index in range(len(feed.rows))], [row.stamp_ns for row in feed.rows], pictures
    if not fps > 0:
        raise FeedError(f"--fps: {fps:g} is not above 0")
    names = list_pictures(path)
    stamps_ns = [round(index * 1e9 / fps) for index in range(len(names))]
    return names, stamps_ns, PictureFiles([path / name for name in names])
