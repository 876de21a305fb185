"""Writes a feed while frames come from a camera: for `lookback record`, and for [recording] of `lookback run`.

The feed is written by a thread, since recording must never cost a place: a disk that is slow, full or gone costs
frames of the recording and nothing else. A frame is handed over without waiting; while the disk is QUEUE_FRAMES behind,
further frames are skipped.
"""

from __future__ import annotations

import contextlib
import logging
import queue
import shutil
import signal
import threading
import time
from collections.abc import Callable
from pathlib import Path

from msgspec import UNSET
from msgspec.structs import asdict

from edge.config import CameraConfig
from edge.errors import FeedError, reason
from edge.feed.format import FeedHeader, FeedRow
from edge.feed.reader import Frame
from edge.feed.writer import FeedWriter
from edge.geodesy import VehiclePosition

QUEUE_FRAMES = 16
RETRY_S = 5.0  # as the journal
DISK_FULL = "the disk is nearly full"
log = logging.getLogger(__name__)


def free_bytes_at(path: Path) -> int:
    """Free bytes of the disk that `path` is on, or will be once it is made."""
    existing = next(folder for folder in (path.absolute(), *path.absolute().parents) if folder.exists())
    return shutil.disk_usage(existing).free


class Recorder:
    """One feed, written by a thread of its own."""

    def __init__(
        self,
        begin: Callable[[Frame], FeedWriter],
        min_free_bytes: float,
        *,
        free_bytes: Callable[[Path], int] = free_bytes_at,
        retry_s: float = RETRY_S,
    ) -> None:
        """Start the thread. begin: makes the feed with its first frame, see `begun_feed`.

        min_free_bytes: nothing is recorded while the disk has less than this left. retry_s: pause between tries.
        """
        self._begin = begin
        self._min_free_bytes, self._free_bytes = min_free_bytes, free_bytes
        self._queue: queue.Queue[tuple[Frame, float | None, VehiclePosition | None] | None] = queue.Queue(QUEUE_FRAMES)
        self._writer: FeedWriter | None = None
        self.written = 0
        self.with_position = 0
        self.skipped = 0
        """Frames that came while the disk was behind."""
        self.stopped = ""
        """Why nothing is recorded now, "" while recording."""
        self._closing = threading.Event()
        self._retry_s, self._tries_at_s = retry_s, 0.0
        self._thread = threading.Thread(target=self._run, name="recording", daemon=True)
        self._thread.start()

    def record(self, frame: Frame, distance_m: float | None, position: VehiclePosition | None) -> None:
        """Hand a frame over, with what the autopilot reports of its exposure; never waits and never raises."""
        try:
            self._queue.put_nowait((frame, distance_m, position))
        except queue.Full:
            self.skipped += 1

    def end(self) -> None:
        """Begin to write the last of what was handed over; more than once is harmless."""
        self._closing.set()
        with contextlib.suppress(queue.Full):  # then the thread looks whether it is closing
            self._queue.put_nowait(None)

    def close(self, timeout_s: float = 1.0) -> None:
        """Write what has been handed over, for at most `timeout_s`; more than once is harmless."""
        self.end()
        self._thread.join(timeout_s)

    def _run(self) -> None:
        signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
        while not (self._closing.is_set() and self._queue.empty()):
            queued = self._queue.get()
            if queued is None or time.monotonic() < self._tries_at_s:
                continue
            try:
                self._write(*queued)
            except (OSError, FeedError) as error:
                self._stop(reason(error))
        if self._writer is not None:
            self._writer.close()

    def _write(self, frame: Frame, distance_m: float | None, position: VehiclePosition | None) -> None:
        writer = self._writer = self._writer or self._begin(frame)
        if self._free_bytes(writer.path) < self._min_free_bytes:
            self._stop(DISK_FULL)
            return
        row = FeedRow("", frame.stamp_ns, distance_m=distance_m)
        if position is not None:
            at = position.lat_deg, position.lon_deg, position.alt_m, position.heading_deg, position.speed_mps
            row = FeedRow("", frame.stamp_ns, *at, distance_m, position.sigma_m, position.source)
        writer.write(frame.image, row)
        if self.stopped:
            log.warning("recording: %s: goes on", writer.path)
        self.stopped = ""
        self.written += 1
        self.with_position += position is not None

    def _stop(self, why: str) -> None:
        folder = f"{self._writer.path}: " if self._writer else ""
        if not self.stopped:
            log.warning("recording: %swaits after %d frames: %s", folder, self.written, why)
        self.stopped = why
        self._tries_at_s = time.monotonic() + self._retry_s


def begun_feed(path: Path, camera: CameraConfig, frame: Frame, notes: str = "") -> FeedWriter:
    """A new feed whose first frame is this one: only now is the size known that the camera really gives."""
    height, width = frame.image.shape[:2]
    processed = camera.preprocessing
    about = path.name, camera.view, width, height, camera.source, notes
    # While GPS works, the autopilot's velocity and with it distance_m are GPS's own: they do not vouch for positions.
    fov_deg = None if camera.fov_deg is UNSET else camera.fov_deg
    optics = {"fov_deg": fov_deg, **asdict(camera.alone)}
    writer = FeedWriter(path, FeedHeader(*about, preprocessing=processed, time_sigma_s=0.0, **optics))
    log.info("recording: %s", path)
    return writer
