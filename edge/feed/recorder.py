"""Writes a feed while frames come from a camera: for `lookback record`, and for [recording] of `lookback run`.

The feed is written by a thread, since recording must never cost a place: a disk that is slow, full or gone costs
frames of the recording and nothing else. A frame is handed over without waiting; while the disk is QUEUE_FRAMES behind,
further frames are skipped.
"""

from __future__ import annotations

import logging
import queue
import shutil
import signal
import threading
import time
from collections import deque
from collections.abc import Callable
from datetime import datetime, timezone
from pathlib import Path
from typing import Protocol

from edge.config import CameraConfig
from edge.errors import FeedError
from edge.feed.format import FeedHeader
from edge.feed.reader import Frame
from edge.feed.writer import FeedWriter
from edge.geodesy import VehiclePosition

QUEUE_FRAMES = 16
DISK_FULL = "the disk is nearly full"
log = logging.getLogger(__name__)


def free_bytes_at(path: Path) -> int:
    """Free bytes of the disk that `path` is on, or will be once it is made."""
    existing = next(folder for folder in (path.absolute(), *path.absolute().parents) if folder.exists())
    return shutil.disk_usage(existing).free


class Positions(Protocol):
    """Where the vehicle was at an exposure: `AutopilotConnection.history`."""

    def at(self, stamp_ns: int) -> VehiclePosition | None:
        """Its position at that moment, None where it is not known."""

    def is_awaited(self, stamp_ns: int) -> bool:
        """Whether the position after that moment has not come yet, and still may."""


class FramesAwaitingPosition:
    """Frames until the position after their exposure is known, since a position is interpolated; then recorded."""

    def __init__(self, recorder: Recorder, positions: Positions) -> None:
        self._recorder, self._positions = recorder, positions
        self._frames: deque[tuple[Frame, float | None]] = deque()

    def add(self, frame: Frame, distance_m: float | None) -> None:
        """A frame that is to be recorded, and how far the vehicle had driven."""
        self._frames.append((frame, distance_m))

    def record(self, *, all_of_them: bool = False) -> None:
        """Record what is ready, or all at the end."""
        while self._frames and (all_of_them or not self._positions.is_awaited(self._frames[0][0].stamp_ns)):
            frame, distance_m = self._frames.popleft()
            self._recorder.record(frame, self._positions.at(frame.stamp_ns), distance_m)


class Recorder:
    """One feed, written by a thread of its own."""

    def __init__(
        self,
        feed: Callable[[], Path],
        camera: CameraConfig,
        min_free_bytes: float,
        *,
        notes: Callable[[], str] = lambda: "",
        free_bytes: Callable[[Path], int] = free_bytes_at,
    ) -> None:
        """Start the thread. Nothing is written before the first frame, when `feed` names the folder to make.

        notes: of the feed's header. min_free_bytes: recording stops when the disk has less than this left.
        """
        self._feed, self._camera, self._notes = feed, camera, notes
        self._min_free_bytes, self._free_bytes = min_free_bytes, free_bytes
        self._queue: queue.Queue[tuple[Frame, VehiclePosition | None, float | None] | None] = queue.Queue(QUEUE_FRAMES)
        self._writer: FeedWriter | None = None
        self._path = Path()
        self.written = 0
        self.with_position = 0
        self.skipped = 0
        """Frames that came while the disk was behind."""
        self.stopped = ""
        """Why nothing is recorded any more, "" while recording."""
        self._thread = threading.Thread(target=self._run, name="recording", daemon=True)
        self._thread.start()

    def record(self, frame: Frame, position: VehiclePosition | None, distance_m: float | None) -> None:
        """Hand a frame over, with what the autopilot reports of its exposure; never waits and never raises."""
        if self.stopped:
            return
        try:
            self._queue.put_nowait((frame, position, distance_m))
        except queue.Full:
            self.skipped += 1

    def close(self, timeout_s: float = 1.0) -> None:
        """Write what has been handed over, for at most `timeout_s` twice; more than once is harmless."""
        try:
            self._queue.put(None, timeout=timeout_s)
        except queue.Full:
            return  # the disk hangs; the thread ends with the process, and its feed is whole up to the last row
        self._thread.join(timeout_s)

    def _run(self) -> None:
        signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
        try:
            while (queued := self._queue.get()) is not None:
                self._write(*queued)
        except (OSError, FeedError) as error:
            self._stop(getattr(error, "strerror", None) or str(error))
            while self._queue.get() is not None:
                pass  # so that close() never waits for room
        finally:
            if self._writer is not None:
                self._writer.close()

    def _write(self, frame: Frame, position: VehiclePosition | None, distance_m: float | None) -> None:
        if self.stopped:
            return
        writer = self._writer or self._open(frame)
        if self._free_bytes(self._path) < self._min_free_bytes:
            self._stop(DISK_FULL)
            return
        writer.write(
            frame.image,
            frame.stamp_ns,
            lat_deg=position.lat_deg if position else None,
            lon_deg=position.lon_deg if position else None,
            alt_m=position.alt_m if position else None,
            heading_deg=position.heading_deg if position else None,
            speed_mps=position.speed_mps if position else None,
            distance_m=distance_m,
            position_sigma_m=position.sigma_m if position else None,
            position_source=position.source if position else "unknown",
        )
        self.written += 1
        self.with_position += position is not None

    def _open(self, frame: Frame) -> FeedWriter:
        """Make the feed's folder; only now is the size known that the camera really gives."""
        self._path = self._feed()
        height, width = frame.image.shape[:2]
        camera = self._camera
        header = FeedHeader(
            self._path.name,
            camera.view,
            width,
            height,
            camera.source,
            self._notes(),
            preprocessing=camera.preprocessing,
        )
        self._writer = FeedWriter(self._path, header)
        log.info("recording: %s", self._path)
        return self._writer

    def _stop(self, why: str) -> None:
        self.stopped = why
        log.warning("recording: %s: stopped after %d frames: %s", self._path, self.written, why)


def run_folder(folder: Path, unix_time_s: Callable[[], float] = time.time) -> Path:
    """A new folder for the feed of one run, named by the time. Two runs may begin in the same second."""
    started = datetime.fromtimestamp(unix_time_s(), tz=timezone.utc).strftime("%Y%m%dT%H%M%SZ")
    names = [started, *(f"{started}-{number}" for number in range(2, 1000))]
    return folder / next(name for name in names if not (folder / name).exists())
