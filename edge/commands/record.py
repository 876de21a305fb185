"""`lookback record`: the camera that the config names, to a feed, with what the autopilot says about where it is.

newest camera frame -> is it a place? -> picture and row, with the autopilot's position and distance where known
"""

from __future__ import annotations

import argparse
import logging
import math
import shutil
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeAlias

from tqdm import tqdm

from edge.camera import Frame, open_camera
from edge.camera.newest import NewestFrame
from edge.config import Config, load_config, naming
from edge.errors import CameraLost, FeedError
from edge.feed import FeedHeader, FeedWriter
from edge.feed.recorder import feed_header, write_frame
from edge.feed.sampling import Sampler
from edge.health.service import when_told_to_stop
from edge.telemetry.autopilot import AutopilotConnection

TURN_S = 0.02  # at most this long between looks at the MAVLink port
MIN_FREE_BYTES = 200_000_000
Why: TypeAlias = Literal["told to stop", "time is over", "camera ended", "disk nearly full"]
log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Recording:
    """What was recorded: rows written, of these how many with a position, and why it stopped."""

    frames: int
    with_position: int
    why: Why


def add_command(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `lookback record` to the command line."""
    parser = commands.add_parser("record", help="record a traverse: camera and positions, to a feed")
    parser.add_argument("config", type=Path, metavar="CONFIG")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FEED", help="folder to make")
    parser.add_argument("--duration", type=float, default=math.inf, metavar="S", help="stop after so many seconds")
    parser.add_argument(
        "--min-free-mb",
        type=float,
        default=MIN_FREE_BYTES / 1e6,
        metavar="MB",
        help="stop when the disk has less than this left (default %(default)g)",
    )
    parser.set_defaults(run=_run)


class Recorder:
    """The running parts; `turn` moves at most one frame from the camera to the feed."""

    def __init__(
        self,
        config: Config,
        path: Path,
        parts: ExitStack,
        clock_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        """Open the camera and the link to the autopilot; SetupError. `parts` closes what was opened.

        An autopilot that is not there is no error: rows then have no position, and are sampled by time.
        """
        if (path / "frames.csv").exists():  # said before the camera is opened, which can take seconds
            raise FeedError(f"{path}: there is a feed here already; name another folder")
        self._config = config
        self._path = path
        self._parts = parts
        self._clock_ns = clock_ns
        self._sampler = Sampler(config.sampling)
        self._writer: FeedWriter | None = None
        self._autopilot = parts.enter_context(closing(AutopilotConnection(config.telemetry, clock_ns)))
        reopens = config.camera.kind != "feed"  # which would begin anew
        camera = NewestFrame(lambda: open_camera(config.camera), reopens=reopens, clock_ns=clock_ns)
        self._camera = parts.enter_context(closing(camera))
        self._camera_state = ""
        self.frames = 0
        self.with_position = 0

    def turn(self) -> bool:
        """One turn of the loop; False when the camera has come to its end. FeedError when the disk refuses a frame."""
        self._autopilot.poll()
        frame = self._camera.take(TURN_S)
        if frame is not None:
            distance_m = self._autopilot.vehicle.distance_m(frame.stamp_ns)
            if self._sampler.take(frame.stamp_ns, distance_m):
                self._write(frame, distance_m)
        self._tell_camera()
        return not self._camera.ended

    def _write(self, frame: Frame, distance_m: float | None) -> None:
        if self._writer is None:  # only now is the size known that the camera really gives
            self._writer = self._parts.enter_context(FeedWriter(self._path, self._header(frame)))
        position = self._autopilot.vehicle.position(self._clock_ns())
        try:
            write_frame(self._writer, frame, position, distance_m)
        except OSError as error:
            raise FeedError(f"{self._path}: stopped after {self.frames} frames: {error.strerror}") from None
        self.frames += 1
        self.with_position += position is not None

    def _header(self, frame: Frame) -> FeedHeader:
        notes = "; ".join(self._camera.health.differences)
        return feed_header(self._path.name, self._config.camera, frame, notes)

    def _tell_camera(self) -> None:
        health = self._camera.health
        if health.state != self._camera_state:
            self._camera_state = health.state
            for line in (health.reason, *health.differences):
                if line:
                    log.warning("camera %s: %s", health.state, line)

    def why_no_frames(self) -> str:
        """The camera's last words, for the error when nothing came."""
        return self._camera.health.reason or "the camera gave no frame"


def record(
    config: Config,
    path: Path,
    stop: threading.Event,
    *,
    duration_s: float = math.inf,
    min_free_bytes: float = MIN_FREE_BYTES,
    free_bytes: Callable[[], int] | None = None,
    clock_ns: Callable[[], int] = time.monotonic_ns,
) -> Recording:
    """Record until `stop` is set, the time is over, the camera ends, or the disk has less than `min_free_bytes`.

    free_bytes: what the disk under `path` has left. Raises SetupError, and CameraLost when no frame came at all.
    """
    free_bytes = free_bytes or (lambda: shutil.disk_usage(_existing(path)).free)
    with ExitStack() as parts:
        recorder = Recorder(config, path, parts, clock_ns)
        # On a terminal only: a service's log is no place for a counter.
        counter = parts.enter_context(tqdm(unit=" frames", disable=None))
        deadline_ns = clock_ns() + duration_s * 1e9
        why: Why | None = None
        while why is None:
            if free_bytes() < min_free_bytes:
                why = "disk nearly full"
            elif stop.is_set():
                why = "told to stop"
            elif clock_ns() >= deadline_ns:
                why = "time is over"
            elif not recorder.turn():
                why = "camera ended"
            counter.update(recorder.frames - counter.n)
        if recorder.frames == 0:
            raise CameraLost(f"{path}: nothing recorded ({why}): {recorder.why_no_frames()}")
        return Recording(recorder.frames, recorder.with_position, why)


def _existing(path: Path) -> Path:
    """The folder, or the nearest above it that there is: the disk that a new folder will be on."""
    return next(folder for folder in (path.absolute(), *path.absolute().parents) if folder.exists())


def _run(args: argparse.Namespace) -> int:
    config = load_config(args.config)
    stop = threading.Event()
    with when_told_to_stop(stop.set), naming(args.config):
        done = record(config, args.output, stop, duration_s=args.duration, min_free_bytes=args.min_free_mb * 1e6)
    log.info("%s: %d frames, %d with a position; %s", args.output, done.frames, done.with_position, done.why)
    return 1 if done.why == "disk nearly full" else 0
