"""The feed: a recorded traverse that every tool reads and writes.

A folder with `feed.toml` (`FeedHeader`), `frames.csv` (a row a frame, at least `file` and `stamp_ns`) and the pictures:
files under `frames/`, or one video whose name `feed.toml` gives as `video` (rows are then its frames in order). Where
they are known, a row also has `lat_deg, lon_deg, alt_m, heading_deg, speed_mps, distance_m`; further columns are kept
as text. A bare video file is read as a feed as well: its rows are its frames, each with its own time in the video
(phones record at a rate that varies) and nothing else known.

Recordings of other kinds are read by plug-ins: an entry point `lookback.feeds`, named by the file's suffix, is a
function of the path and a `FeedOptions` that returns a `Feed` with a `pictures` of its own.
"""

from __future__ import annotations

import os
import stat
import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.errors import FeedError, FrameError
from edge.feed.format import FeedHeader, FeedRow, View, file_inside, read_header, read_rows


@dataclass(frozen=True)
class Frame:
    """One picture.

    image: (H, W, 3) uint8, BGR as OpenCV has it; the camera's own buffer, not to be written to.
    stamp_ns: exposure on CLOCK_MONOTONIC for live cameras, the feed's own time for feeds read as files.
    index: the camera's frame counter, or the row of the feed; gaps are frames that were never read.
    """

    image: NDArray[np.uint8]
    stamp_ns: int
    index: int


# FFmpeg prints lines of its own about a video that it cannot read; here that is one error. Read at its first use.
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")


class Pictures(Protocol):
    """The pictures of a recording, read when they are asked for; quickest in row order."""

    def read(self, index: int) -> NDArray[np.uint8]:
        """Picture of row `index`, (H, W, 3) uint8 BGR. FrameError names the picture."""

    def close(self) -> None:
        """Release files; more than once is harmless."""


@dataclass(frozen=True)
class Feed:
    """A feed's header and rows; the pictures stay on the disk until `FeedImages` reads them.

    pictures: opens those of a recording of another kind; None where they are the files, or the video, of a feed.
    """

    path: Path
    header: FeedHeader
    rows: tuple[FeedRow, ...]
    pictures: Callable[[], Pictures] | None = None


@dataclass(frozen=True)
class FeedOptions:
    """What a recording that is not a feed may not contain.

    view: which way its camera faced; None: as recorded, else front. video: the video of a log; None: the one beside it
    with the same name. offset_s: seconds from the log's first position to the video's first frame; None: found out.
    """

    view: View | None = None
    video: Path | None = None
    offset_s: float | None = None


def read_feed(path: Path, options: FeedOptions | None = None) -> Feed:
    """Read and check the header and all rows of a feed folder, or of a file: a bare video, or what a plug-in reads.

    Raises FeedError, which names the file and the line or the key. The stamps of a feed strictly increase.
    """
    options = options or FeedOptions()
    if path.is_file():
        return _read_file(path, options)
    if not path.is_dir():
        raise FeedError(f"{path}: no such feed; it is a folder with feed.toml, frames.csv and frames/, or a video file")
    if options != FeedOptions():
        raise FeedError(
            f"{path}: --view and --video are for recordings; this is a feed folder; edit its feed.toml instead"
        )
    header = read_header(file_inside(path, "feed.toml"))
    rows = read_rows(file_inside(path, "frames.csv"))
    if header.video and not file_inside(path, header.video).is_file():
        raise FeedError(f"{path / header.video}: the video that feed.toml names is missing")
    return Feed(path, header, rows)


def _read_file(path: Path, options: FeedOptions) -> Feed:
    """A recording, by the installed reader of its suffix, or else a video."""
    for point in entry_points(group="lookback.feeds", name=path.suffix.lower().removeprefix(".")):
        try:
            feed: Feed = point.load()(path, options)
        except ModuleNotFoundError as error:
            raise FeedError(f"{path}: to read it, {point.value} needs the package {error.name}") from None
        return feed
    if (options.video, options.offset_s) != (None, None):
        raise FeedError(f"{path}: --video is for a log (.tlog, .bin, .ulg), and this is not one")
    return _read_bare_video(path, options.view or "front")


def _read_bare_video(path: Path, view: View) -> Feed:
    video = _open_video(path)
    width, height = int(video.get(cv2.CAP_PROP_FRAME_WIDTH)), int(video.get(cv2.CAP_PROP_FRAME_HEIGHT))
    times_ns = _frame_times_ns(path, video)
    video.release()
    if not times_ns or not width * height:
        raise FeedError(f"{path}: no picture in this video; if it was cut off while recording, repair it first")
    header = FeedHeader(path.stem, view, width, height, source=path.name)
    rows = tuple(FeedRow("", time_ns) for time_ns in times_ns)
    return Feed(path, header, rows, lambda: VideoPictures(path))


def _frame_times_ns(path: Path, video: cv2.VideoCapture) -> list[int]:
    """When each frame of a video is shown, from the first on, strictly rising. FeedError.

    From the packets where the package av is installed; else all frames are decoded, which takes far longer.
    """
    try:
        import av
    except ModuleNotFoundError:
        times_ns = []
        while video.grab():
            times_ns.append(round(video.get(cv2.CAP_PROP_POS_MSEC) * 1e6))
    else:
        try:
            with av.open(str(path)) as container:
                stream = container.streams.video[0]
                shown = (one.pts for one in container.demux(stream) if one.pts is not None and not one.is_discard)
                tick_ns = (stream.time_base or 0) * 10**9
                times_ns = [round(pts * tick_ns) for pts in sorted(shown)]
        except (av.FFmpegError, IndexError) as error:
            raise FeedError(f"{path}: cannot read this video: {error}") from None
    return [time_ns - times_ns[0] for time_ns in dict.fromkeys(times_ns)]


def _open_video(path: Path) -> cv2.VideoCapture:
    video = cv2.VideoCapture(str(path)) if path.stat().st_size else None
    if video is None or not video.isOpened():
        if not path.stat().st_size:
            raise FeedError(f"{path}: it is empty")
        others = "".join(sorted({f", or *.{point.name}" for point in entry_points(group="lookback.feeds")}))
        raise FeedError(
            f"{path}: neither a feed folder nor a video that OpenCV can read{others}; a video that was cut off while it"
            " was recorded has no index: repair it (untrunc), or record it again"
        )
    return video


def read_picture(file: Path, flags: int = cv2.IMREAD_COLOR) -> NDArray[np.uint8]:
    """A picture file as OpenCV reads it, (H, W, 3) uint8 BGR unless the flags say otherwise. FrameError names it."""
    # imdecode of bytes, since imread prints its own warnings to stderr for a missing file.
    try:
        if not stat.S_ISREG(file.stat().st_mode):
            raise FrameError(f"{file}: not a regular file")
        data = np.fromfile(file, dtype=np.uint8)
    except OSError as error:
        raise FrameError(f"{file}: cannot read it: {error.strerror}") from None
    return decode_picture(str(file), data, flags)


def decode_picture(where: str, data: bytes | NDArray[np.uint8], flags: int = cv2.IMREAD_COLOR) -> NDArray[np.uint8]:
    """The bytes of a picture file, see `read_picture`. FrameError, which begins with `where`."""
    encoded = np.frombuffer(data, np.uint8)
    try:
        image = cv2.imdecode(encoded, flags) if encoded.size else None
    except cv2.error as error:
        image = None
        if "CV_IO_MAX" in str(error):
            most = os.environ["OPENCV_IO_MAX_IMAGE_PIXELS"]
            raise FrameError(f"{where}: more than {most} pixels, which OPENCV_IO_MAX_IMAGE_PIXELS allows") from None
    if image is None:
        raise FrameError(f"{where}: not a complete JPEG or PNG image")
    return np.asarray(image, dtype=np.uint8)


class VideoPictures:
    """The pictures of a video, one after the other; going back begins again."""

    def __init__(self, file: Path) -> None:
        """FeedError for what is no video."""
        self._file, self._video, self._next = file, _open_video(file), 0

    def read(self, index: int) -> NDArray[np.uint8]:
        """Picture `index`, (H, W, 3) uint8 BGR, turned upright. FrameError."""
        # Frame by frame: where the rate varies, OpenCV jumps to another frame than the one asked for.
        if index < self._next:
            self._video.open(str(self._file))
            self._next = 0
        while self._next < index and self._video.grab():
            self._next += 1
        ok, image = self._video.read() if self._next == index else (False, None)
        if not ok or image is None:
            raise FrameError(f"{self._file}: no frame {index} in this video")
        self._next = index + 1
        return np.asarray(image, dtype=np.uint8)

    def close(self) -> None:
        """Release the file, which the next picture opens again."""
        self._video.release()
        self._next = sys.maxsize


class FeedImages:
    """The pictures of a feed, of the size that its header gives; quickest in row order."""

    def __init__(self, feed: Feed) -> None:
        self._feed = feed
        self._others: Pictures | None = feed.pictures() if feed.pictures else None
        if feed.header.video:
            self._others = VideoPictures(feed.path / feed.header.video)

    def read(self, index: int) -> NDArray[np.uint8]:
        """Picture of row `index`, (height, width, 3) uint8 BGR, of the size that the header gives.

        Raises FrameError that names the file, or the video's frame.
        """
        header = self._feed.header
        if self._others is not None:
            name, image = f"{self._feed.path}: picture {index}", self._others.read(index)
        else:
            file = file_inside(self._feed.path, self._feed.rows[index].file, FrameError)
            name, image = str(file), read_picture(file)
        height, width = image.shape[:2]
        if (width, height) != (header.width, header.height):
            raise FrameError(f"{name}: {width} x {height} pixels, and feed.toml says {header.width} x {header.height}")
        return image

    def close(self) -> None:
        """Release what is open; more than once is harmless."""
        if self._others is not None:
            self._others.close()
