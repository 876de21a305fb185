"""The feed: a recorded traverse that every tool reads and writes.

A folder with `feed.toml` (name, view, width, height, source, notes), `frames.csv` (a row a frame, at least `file`
and `stamp_ns`) and the pictures: files under `frames/`, or one video whose name `feed.toml` gives as `video`
(rows are then its frames in order). Where they are known, a row also has `lat_deg, lon_deg, alt_m, heading_deg,
speed_mps, distance_m`; further columns are kept as text.
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Literal, TextIO

import cv2
import msgspec
import numpy as np
import tomli_w
from numpy.typing import NDArray

from edge.errors import FeedError, FrameError

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

JPEG_QUALITY = 92
MEASURES = ("lat_deg", "lon_deg", "alt_m", "heading_deg", "speed_mps", "distance_m")


class FeedHeader(msgspec.Struct, frozen=True):
    """`feed.toml`; keys that are not listed here are ignored."""

    name: str
    view: Literal["front", "rear"]
    width: int
    height: int
    source: str = ""
    notes: str = ""
    video: str = ""


@dataclass(frozen=True)
class FeedRow:
    """One row of `frames.csv`; what is not known is None. `extra` has the further columns as text."""

    file: str
    stamp_ns: int
    lat_deg: float | None = None
    lon_deg: float | None = None
    alt_m: float | None = None
    heading_deg: float | None = None
    speed_mps: float | None = None
    distance_m: float | None = None
    extra: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Feed:
    """A feed's header and rows; the pictures stay on the disk until `FeedImages` reads them."""

    path: Path
    header: FeedHeader
    rows: tuple[FeedRow, ...]


def read_feed(path: Path) -> Feed:
    """Read and check header and rows; FeedError names the file, and the line or the key."""
    if not path.is_dir():
        raise FeedError(f"{path}: no such feed folder; a feed has feed.toml, frames.csv and frames/")
    header = _read_header(path / "feed.toml")
    rows = _read_rows(path / "frames.csv")
    if header.video and not (path / header.video).is_file():
        raise FeedError(f"{path / header.video}: the video that feed.toml names is missing")
    return Feed(path, header, rows)


def _read_header(file: Path) -> FeedHeader:
    try:
        return msgspec.convert(tomllib.loads(file.read_text(encoding="utf-8")), FeedHeader)
    except OSError as error:
        raise FeedError(f"{file}: cannot read it: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, msgspec.ValidationError, UnicodeDecodeError) as error:
        raise FeedError(f"{file}: {error}") from None


def _read_rows(file: Path) -> tuple[FeedRow, ...]:
    try:
        with file.open(newline="", encoding="utf-8") as stream:
            reader = csv.DictReader(stream)
            missing = {"file", "stamp_ns"} - set(reader.fieldnames or ())
            if missing:
                raise FeedError(f"{file}: no column {' and no column '.join(sorted(missing))} in its first line")
            rows = tuple(_parse_row(file, reader.line_num, values) for values in reader)
    except OSError as error:
        raise FeedError(f"{file}: cannot read it: {error.strerror}") from None
    except (csv.Error, UnicodeDecodeError) as error:
        raise FeedError(f"{file}: {error}") from None
    if not rows:
        raise FeedError(f"{file}: no frames in it")
    return rows


def _parse_row(file: Path, line: int, values: dict[str, str | None]) -> FeedRow:
    """One CSV row as a FeedRow; an empty or missing measure is None."""
    name, stamp = values.get("file"), values.get("stamp_ns")
    if not name or not stamp:
        raise FeedError(f"{file}: line {line}: file or stamp_ns is empty; is the file cut short?")
    column = "stamp_ns"
    try:
        stamp_ns = int(stamp)
        measures: dict[str, float | None] = {}
        for column in MEASURES:
            text = values.get(column)
            measures[column] = float(text) if text else None
    except ValueError:
        raise FeedError(f"{file}: line {line}: {column}: {values[column]!r} is not a number") from None
    known = {"file", "stamp_ns", *MEASURES}
    extra = {key: text or "" for key, text in values.items() if key is not None and key not in known}
    return FeedRow(name, stamp_ns, **measures, extra=extra)


class FeedImages:
    """The pictures of a feed, read in row order (video) or in any order (files)."""

    def __init__(self, feed: Feed) -> None:
        self._feed = feed
        self._video: cv2.VideoCapture | None = None
        self._next_video_frame = 0
        if feed.header.video:
            self._video = cv2.VideoCapture(str(feed.path / feed.header.video))
            if not self._video.isOpened():
                raise FeedError(f"{feed.path / feed.header.video}: OpenCV cannot read this video")

    def read(self, index: int) -> NDArray[np.uint8]:
        """Picture of row `index`, (H, W, 3) uint8 BGR. Raises FrameError that names the file, or the video's frame."""
        if self._video is not None:
            return self._read_video(self._video, index)
        file = self._feed.path / self._feed.rows[index].file
        # imdecode of bytes, since imread prints its own warnings to stderr for a missing file.
        try:
            data = np.fromfile(file, dtype=np.uint8)
        except OSError as error:
            raise FrameError(f"{file}: cannot read it: {error.strerror}") from None
        image = cv2.imdecode(data, cv2.IMREAD_COLOR) if data.size else None
        if image is None:
            raise FrameError(f"{file}: not a whole JPEG or PNG picture")
        return np.asarray(image, dtype=np.uint8)

    def _read_video(self, video: cv2.VideoCapture, index: int) -> NDArray[np.uint8]:
        if index != self._next_video_frame:
            video.set(cv2.CAP_PROP_POS_FRAMES, index)
        self._next_video_frame = index + 1
        ok, image = video.read()
        if not ok:
            raise FrameError(f"{self._feed.path / self._feed.header.video}: no frame {index} in this video")
        return np.asarray(image, dtype=np.uint8)

    def close(self) -> None:
        """Release the video, if there is one."""
        if self._video is not None:
            self._video.release()


class FeedWriter:
    """Writes a feed frame by frame: picture first, then its row, so that a crash leaves only whole rows."""

    def __init__(self, path: Path, header: FeedHeader, extra_columns: tuple[str, ...] = ()) -> None:
        """Create the folder; FeedError if it already has a feed in it, or cannot be written."""
        self._path = path
        self._count = 0
        self._file: TextIO
        if (path / "frames.csv").exists():
            raise FeedError(f"{path}: there is a feed here already; name another folder")
        try:
            (path / "frames").mkdir(parents=True, exist_ok=True)
            (path / "feed.toml").write_text(tomli_w.dumps(msgspec.structs.asdict(header)), encoding="utf-8")
            self._file = (path / "frames.csv").open("w", newline="", encoding="utf-8")
        except OSError as error:
            raise FeedError(f"{path}: cannot write a feed here: {error.strerror}") from None
        self._extra_columns = extra_columns
        self._rows = csv.writer(self._file)
        self._rows.writerow(["file", "stamp_ns", *MEASURES, *extra_columns])

    def write(
        self,
        image: NDArray[np.uint8],
        stamp_ns: int,
        *,
        lat_deg: float | None = None,
        lon_deg: float | None = None,
        alt_m: float | None = None,
        heading_deg: float | None = None,
        speed_mps: float | None = None,
        distance_m: float | None = None,
        extra: Mapping[str, str] | None = None,
    ) -> None:
        """Append one frame; image (H, W, 3) uint8 BGR. OSError when the disk is full: what was written stays whole."""
        file = f"frames/{self._count:06d}.jpg"
        _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
        data.tofile(self._path / file)
        measures = (lat_deg, lon_deg, alt_m, heading_deg, speed_mps, distance_m)
        known = ["" if value is None else repr(value) for value in measures]
        self._rows.writerow([file, stamp_ns, *known, *((extra or {}).get(key, "") for key in self._extra_columns)])
        self._file.flush()
        self._count += 1

    def __enter__(self) -> FeedWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the row file; more than once is harmless."""
        self._file.close()
