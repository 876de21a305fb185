"""Pictures in folders and videos, in the order they were taken."""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.errors import FeedError, FrameError
from edge.feed import Feed, FeedImages, Pictures, read_feed, read_picture
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


@dataclass(frozen=True)
class JoinedVideos:
    """The parts of one recording, put together without a gap.

    feeds, starts_ns: each part, and when it begins. names, stamps_ns: of each picture of all.
    """

    feeds: list[Feed]
    starts_ns: list[int]
    names: list[str]
    stamps_ns: list[int]
    pictures: Pictures


def join_videos(files: Sequence[Path]) -> JoinedVideos:
    """The frames of videos, each after the one before. FeedError names the file."""
    feeds, opened = zip(*map(open_video, files), strict=True)
    starts_ns, names, stamps_ns = [0], list[str](), list[int]()
    for file, feed in zip(files, feeds, strict=True):
        names += [f"{file.name} {row}" if len(files) > 1 else str(row) for row in range(len(feed.rows))]
        stamps_ns += [starts_ns[-1] + row.stamp_ns for row in feed.rows]
        starts_ns.append(stamps_ns[-1] + (feed.rows[-1].stamp_ns // max(len(feed.rows) - 1, 1) or 1))
    return JoinedVideos(
        list(feeds), starts_ns[:-1], names, stamps_ns, JoinedPictures(opened, [len(feed.rows) for feed in feeds])
    )


CHAPTER = re.compile(r"(G[HLX])(\d\d)(\d{4})|(GP)(\d\d)(\d{4})|GOPR(\d{4})")
"""Names of a GoPro: kind, chapter, recording (HERO6 and later); up to HERO5 the first chapter is GOPR0042."""


def chapter_of(file: Path) -> tuple[str, int, int]:
    """Kind, recording and chapter of a GoPro's video; "", 0 and 0 of others."""
    found = CHAPTER.fullmatch(file.stem.upper())
    if not found:
        return "", 0, 0
    kind, chapter, recording = (found[1] or "GP", found[2] or found[5] or "0", found[3] or found[6] or found[7])
    return kind, int(recording), int(chapter)


def chapters_from(file: Path) -> list[Path]:
    """A video, and the further chapters of its recording that lie beside it. FeedError where one between is missing."""
    kind, recording, first = chapter_of(file)
    if not kind or first > 1:
        return [file]
    beside = [one for one in file.parent.iterdir() if one.suffix.lower() == file.suffix.lower()]
    found = sorted((chapter_of(one)[2], one) for one in beside if chapter_of(one)[:2] == (kind, recording))
    for at, (chapter, _) in enumerate(found):
        if chapter != first + at:
            raise FeedError(f"{file}: chapter {first + at} of it is missing, and chapter {chapter} is there")
    return [one for _, one in found]


def video_files(path: Path, ends: str = "") -> list[Path]:
    """The videos of a recording in their order: a video with its chapters, or those in a folder whose names end so."""
    if path.is_file():
        return chapters_from(path)
    files = [one for one in path.iterdir() if one.suffix.lower() in VIDEO_SUFFIXES and one.stem.endswith(ends)]
    return sorted(files, key=lambda one: (chapter_of(one), natural_key(one.name)))


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
