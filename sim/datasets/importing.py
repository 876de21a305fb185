"""A traverse of a data set, written as a feed, or used as one in place."""

from __future__ import annotations

import logging
import math
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.config import SamplingConfig
from edge.errors import FeedError, FrameError
from edge.feed import Feed, FeedHeader, FeedRow, Pictures
from edge.feed.format import LIMITS, check_degrees
from edge.feed.sampling import Sampler
from edge.feed.writer import FeedWriter
from sim.datasets import Traverse
from sim.traverse import driven_m

log = logging.getLogger(__name__)

SOURCE_COLUMNS = ("source_file", "source_frame")


@dataclass(frozen=True)
class ChosenRow:
    """A row of a traverse that becomes a row of the feed, and meters driven since the first known position."""

    index: int
    distance_m: float | None


def choose_rows(
    traverse: Traverse, sampling: SamplingConfig, *, must_have_distance: bool = False, length_m: float = math.inf
) -> list[ChosenRow]:
    """The rows that the sampling selects, up to `length_m` along the drive.

    If positions are known, pictures without one are skipped, with a warning. FeedError if no position is known and
    `must_have_distance`.
    """
    distances_m = _distances_m(traverse)
    placed = any(distance_m is not None for distance_m in distances_m)
    if must_have_distance and not placed:
        raise FeedError(
            f"{traverse.source}: no positions or distances in it, so pictures cannot be chosen by meters; use"
            " --spacing-frames or --interval-s"
        )
    sampler, unplaced, late = Sampler(sampling), 0, 0
    chosen: list[ChosenRow] = []
    last_ns: int | None = None
    for index, (row, distance_m) in enumerate(zip(traverse.rows, distances_m, strict=True)):
        if placed and distance_m is None:
            unplaced += 1
        elif last_ns is not None and row.stamp_ns <= last_ns:
            late += 1
        elif (distance_m is None or distance_m <= length_m) and sampler.is_place(row.stamp_ns, distance_m):
            chosen.append(ChosenRow(index, distance_m))
            last_ns = row.stamp_ns
    for count, why in ((unplaced, "have no position"), (late, "are not later than the one before")):
        if count:
            log.warning("%s: %d of %d pictures %s; skipped", traverse.source, count, len(traverse.rows), why)
    return chosen


def _distances_m(traverse: Traverse) -> list[float | None]:
    """Meters driven at each row, None where its place is not known."""
    rows = traverse.rows
    placed = [index for index, row in enumerate(rows) if row.distance_m is not None or row.lat_deg is not None]
    distances_m: list[float | None] = [None] * len(rows)
    if placed:
        # The size of the pictures is not known yet, and not needed here.
        header = FeedHeader(traverse.name, traverse.view, 1, 1)
        driven = driven_m(Feed(Path(traverse.source), header, tuple(rows[index] for index in placed)))
        for index, distance_m in zip(placed, driven or [], strict=driven is not None):
            distances_m[index] = distance_m
    return distances_m


def write_feed(
    traverse: Traverse,
    output: Path,
    chosen: Iterable[ChosenRow],
    *,
    width: int | None = None,
    skip_unreadable: bool = False,
    lossless: bool = False,
) -> int:
    """Write the chosen rows as a feed at `output`, in one step; returns the number of frames.

    Every row also has `source_file`, and `source_frame`, its number in the data set, so that traverses which were
    aligned frame by frame stay aligned. width: pictures are resized to that many pixels. lossless: PNG instead of JPEG.
    FeedError if `output` exists, or for a picture that cannot be read (skipped if `skip_unreadable`) or has another
    size than the first.
    """
    if output.exists():
        raise FeedError(f"{output}: exists already; name another folder")
    pictures = _pictures(traverse, chosen, width, skip_unreadable)
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{output.name}-", dir=output.parent) as folder:
            count = _write(traverse, Path(folder) / "feed", pictures, lossless)
            (Path(folder) / "feed").rename(output)
    except OSError as error:
        raise FeedError(f"{output}: cannot write a feed here: {error.strerror}") from None
    finally:
        traverse.pictures.close()
    return count


def _pictures(
    traverse: Traverse, chosen: Iterable[ChosenRow], width: int | None, skip_unreadable: bool
) -> Iterator[tuple[ChosenRow, NDArray[np.uint8]]]:
    """The chosen pictures, all of one size."""
    size: tuple[int, ...] | None = None
    for row in chosen:
        try:
            image = _resized(traverse.pictures.read(row.index), width)
        except FrameError as error:
            if not skip_unreadable:
                raise FeedError(f"{error}; --skip-unreadable skips such pictures") from None
            log.warning("%s; skipped", error)
            continue
        size = size or image.shape
        if image.shape != size:
            which = traverse.rows[row.index].file
            raise FeedError(f"{traverse.source}: {which}: {_text(image.shape)}, and the first has {_text(size)} pixels")
        yield row, image


def _write(
    traverse: Traverse, path: Path, pictures: Iterator[tuple[ChosenRow, NDArray[np.uint8]]], lossless: bool
) -> int:
    first = next(pictures, None)
    if first is None:
        raise FeedError(f"{traverse.source}: no picture in it can be used")
    columns = dict.fromkeys([*SOURCE_COLUMNS, *(key for row in traverse.rows for key in row.extra)])
    count = 0
    with FeedWriter(path, _header(traverse, first[1].shape), tuple(columns)) as writer:
        for row, image in chain([first], pictures):
            kept = cv2.imencode(".png", image)[1].tobytes() if lossless else image
            writer.write(kept, feed_row(traverse, row))
            count += 1
    return count


def _header(traverse: Traverse, size: tuple[int, ...]) -> FeedHeader:
    sigma_s = traverse.alignment.sigma_s if traverse.alignment else traverse.time_sigma_s
    size_px = size[1], size[0]
    about = traverse.name, traverse.view, *size_px, traverse.source, traverse.notes
    bent = traverse.lens.lens, traverse.lens.distortion
    return FeedHeader(*about, time_sigma_s=sigma_s, fov_deg=traverse.fov_deg, lens=bent[0], distortion=bent[1])


def feed_row(traverse: Traverse, chosen: ChosenRow) -> FeedRow:
    """The row of a feed that a chosen row becomes; FeedError where its position is not on the earth."""
    row = traverse.rows[chosen.index]
    for column in LIMITS:
        check_degrees(f"{traverse.source}: {row.file}", column, getattr(row, column))
    extra = {"source_file": row.file, "source_frame": str(chosen.index), **row.extra}
    return replace(row, distance_m=chosen.distance_m, extra=extra)


def as_feed(traverse: Traverse, path: Path) -> Feed:
    """All usable rows as a feed, as `write_feed` would write them, without writing. FeedError."""
    chosen = choose_rows(traverse, SamplingConfig(by="frames"))
    _, first = next(_pictures(traverse, chosen, None, skip_unreadable=True), (None, None))
    traverse.pictures.close()
    if first is None:
        raise FeedError(f"{path}: no picture in it can be used")
    indices = [row.index for row in chosen]
    rows = tuple(feed_row(traverse, row) for row in chosen)
    return Feed(path, _header(traverse, first.shape), rows, lambda: _ChosenPictures(traverse.pictures, indices))


class _ChosenPictures:
    """Those of a traverse's pictures that are rows of the feed."""

    def __init__(self, pictures: Pictures, indices: Sequence[int]) -> None:
        self._pictures, self._indices = pictures, indices

    def read(self, index: int) -> NDArray[np.uint8]:
        """Picture of row `index` of the feed."""
        return self._pictures.read(self._indices[index])

    def close(self) -> None:
        """Release files; more than once is harmless."""
        self._pictures.close()


def _resized(image: NDArray[np.uint8], width: int | None) -> NDArray[np.uint8]:
    if width is None or width == image.shape[1]:
        return image
    height = max(1, round(image.shape[0] * width / image.shape[1]))
    return np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _text(shape: tuple[int, ...]) -> str:
    return f"{shape[1]} x {shape[0]}"
