"""What `lookback run` saw, kept as a feed while it runs: [recording]. This file is the thread that writes it.

Recording must never cost a place: a disk that is slow, full or gone costs frames of the recording and nothing else. A
frame is handed over without waiting; when the disk is KEPT frames behind, the next are left out.
"""

from __future__ import annotations

import logging
import queue
import shutil
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path

from edge.camera import Frame
from edge.config import CameraConfig, RecordingConfig
from edge.errors import FeedError
from edge.feed.format import FeedHeader
from edge.feed.writer import FeedWriter
from edge.localization import VehiclePosition

KEPT = 16
log = logging.getLogger(__name__)


def write_frame(writer: FeedWriter, frame: Frame, position: VehiclePosition | None, distance_m: float | None) -> None:
    """Append one frame with what the autopilot says of it. OSError when the disk refuses it."""
    if position is None:
        writer.write(frame.image, frame.stamp_ns, distance_m=distance_m)
        return
    writer.write(
        frame.image,
        frame.stamp_ns,
        lat_deg=position.lat_deg,
        lon_deg=position.lon_deg,
        alt_m=position.alt_m,
        heading_deg=position.heading_deg,
        speed_mps=position.speed_mps,
        distance_m=distance_m,
    )


def feed_header(name: str, camera: CameraConfig, frame: Frame, notes: str = "") -> FeedHeader:
    """The header of a feed that is recorded from this camera."""
    height, width = frame.image.shape[:2]
    return FeedHeader(name, camera.view, width, height, f"{camera.kind} {camera.device}", notes)


@dataclass(frozen=True)
class _Kept:
    frame: Frame
    position: VehiclePosition | None
    distance_m: float | None


class RunRecording:
    """The feed of one run, in a folder that is named by the time of its first frame."""

    def __init__(
        self,
        config: RecordingConfig,
        camera: CameraConfig,
        unix_time_s: Callable[[], float] = time.time,
        free_bytes: Callable[[Path], int] = lambda folder: shutil.disk_usage(folder).free,
    ) -> None:
        """Start the thread; nothing is written before the first frame."""
        self._config, self._camera = config, camera
        self._unix_time_s, self._free_bytes = unix_time_s, free_bytes
        self._frames: queue.Queue[_Kept | None] = queue.Queue(KEPT)
        self._writer: FeedWriter | None = None
        self.written = 0
        self.left_out = 0
        """Frames that came while the disk was behind."""
        self.stopped = ""
        """Why nothing is recorded any more."""
        self._thread = threading.Thread(target=self._run, name="recording", daemon=True)
        self._thread.start()

    def keep(self, frame: Frame, position: VehiclePosition | None, distance_m: float | None) -> None:
        """Hand a frame over; never waits and never raises."""
        if self.stopped:
            return
        try:
            self._frames.put_nowait(_Kept(frame, position, distance_m))
        except queue.Full:
            self.left_out += 1

    def close(self, patience_s: float = 1.0) -> None:
        """Write what has been handed over, for at most `patience_s`; more than once is harmless."""
        try:
            self._frames.put(None, timeout=patience_s)
        except queue.Full:
            return  # the disk hangs; the thread ends with the process, and its feed is whole up to the last row
        self._thread.join(patience_s)

    def _run(self) -> None:
        signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
        try:
            while (kept := self._frames.get()) is not None:
                self._write(kept)
        except (OSError, FeedError) as error:
            self._stop(getattr(error, "strerror", None) or str(error))
            while self._frames.get() is not None:
                pass  # so that close() never waits for room
        finally:
            if self._writer is not None:
                self._writer.close()

    def _write(self, kept: _Kept) -> None:
        if self.stopped:
            return
        folder = Path(self._config.folder)
        if self._writer is None:
            folder.mkdir(parents=True, exist_ok=True)
            started = datetime.fromtimestamp(self._unix_time_s(), tz=timezone.utc).strftime("%Y%m%dT%H%M%SZ")
            name = next(name for name in _names(started) if not (folder / name).exists())
            self._writer = FeedWriter(folder / name, feed_header(name, self._camera, kept.frame))
            log.info("recording: %s", folder / name)
        if self._free_bytes(folder) < self._config.min_free_mb * 1e6:
            self._stop("the disk is nearly full")
            return
        write_frame(self._writer, kept.frame, kept.position, kept.distance_m)
        self.written += 1

    def _stop(self, why: str) -> None:
        self.stopped = why
        log.warning("recording: %s: stopped after %d frames: %s", self._config.folder, self.written, why)


def _names(started: str) -> list[str]:
    """Two runs may begin in the same second, and clocks of vehicles without a battery often do."""
    return [started, *(f"{started}-{number}" for number in range(2, 1000))]
