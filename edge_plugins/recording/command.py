"""`lookback record`: record a traverse as a feed: the camera's frames, the autopilot's positions and distance."""

from __future__ import annotations

import argparse
import logging
import math
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeAlias

import msgspec
from tqdm import tqdm

from edge.camera.checks import open_picture_check
from edge.camera.newest import NewestFrame
from edge.camera.picture_check import PictureCheck
from edge.commands.stop_signal import on_stop_signal
from edge.config import Config, load_config, naming
from edge.errors import CameraLost, ConfigError, FeedError
from edge.feed import Frame
from edge.feed.sampling import Sampler
from edge.feed.writer import FeedWriter
from edge.telemetry.autopilot import AutopilotConnection
from edge.telemetry.position_history import ExposureQueue
from edge_plugins.recording.recorder import DISK_FULL, Recorder, begun_feed, free_bytes_at

TURN_S = 0.02  # at most this long between two reads of the MAVLink port
RECORDING_FLUSH_S = 30.0
"""How long frames that were handed over may take to be written at the end, on a slow disk."""
MIN_FREE_BYTES = 200_000_000
Why: TypeAlias = Literal["stopped by a signal", "duration reached", "camera ended", "disk nearly full"]
log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Recording:
    """What was recorded: rows written, of these how many with a position, and why it stopped.

    skipped: frames that were not written because the disk was too slow.
    """

    frames: int
    with_position: int
    skipped: int
    why: Why


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of `lookback record`."""
    parser.add_argument("config", type=Path, metavar="CONFIG", help="config file (TOML)")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FEED", help="folder of the new feed")
    parser.add_argument("--duration", type=float, default=math.inf, metavar="S", help="stop after S seconds")
    parser.add_argument(
        "--min-free-mb",
        type=float,
        default=MIN_FREE_BYTES / 1e6,
        metavar="MB",
        help="stop when less disk space than this is free (default %(default)g)",
    )
    parser.set_defaults(run=_run)


def record(
    config: Config,
    path: Path,
    stop: threading.Event,
    *,
    duration_s: float = math.inf,
    min_free_bytes: float = MIN_FREE_BYTES,
    free_bytes: Callable[[Path], int] = free_bytes_at,
) -> Recording:
    """Record until `stop` is set, the duration is reached, the camera ends, or the disk has too little space.

    Without an autopilot, rows have no position and are sampled by time. Raises SetupError; FeedError when the disk
    refuses a frame; CameraLost when no frame came at all.
    """
    if not config.camera.keep_pictures:
        raise ConfigError("[camera] keep_pictures: is false, and a recording is pictures; set it to true to record")
    if (path / "frames.csv").exists():  # checked before the camera is opened, which can take seconds
        raise FeedError(f"{path}: a feed already exists here; name another folder")
    with ExitStack() as parts:
        # What the daemon keeps beside its journal is the daemon's alone.
        link = msgspec.structs.replace(config.telemetry, journal="")
        autopilot = parts.enter_context(closing(AutopilotConnection(link)))
        camera = parts.enter_context(closing(NewestFrame.configured(config.camera)))

        def begin(frame: Frame) -> FeedWriter:
            return begun_feed(path, config.camera, frame, "; ".join(camera.health.differences))

        recorder = Recorder(begin, min_free_bytes, free_bytes=free_bytes)
        sampler, deadline_s = Sampler(config.sampling), time.monotonic() + duration_s
        pictures = open_picture_check(camera, config.camera.kind, config.gates.min_speed_mps)

        def ended() -> Why | None:
            if stop.is_set():
                return "stopped by a signal"
            if time.monotonic() >= deadline_s:
                return "duration reached"
            return "camera ended" if camera.ended or recorder.stopped else None

        try:
            why = _fill(recorder, camera, pictures, autopilot, sampler, ended)
        finally:
            recorder.close(RECORDING_FLUSH_S)
        if recorder.stopped == DISK_FULL:
            why = "disk nearly full"
        elif recorder.stopped:
            raise FeedError(f"{path}: stopped after {recorder.written} frames: {recorder.stopped}")
        if recorder.written == 0:
            reason = camera.health.reason or pictures.why_undated or "the camera gave no frame"
            raise CameraLost(f"{path}: nothing recorded ({why}): {reason}")
        return Recording(recorder.written, recorder.with_position, recorder.skipped, why)


def _fill(
    recorder: Recorder,
    camera: NewestFrame,
    pictures: PictureCheck,
    autopilot: AutopilotConnection,
    sampler: Sampler,
    ended: Callable[[], Why | None],
) -> Why:
    """Move frames from the camera to the recorder until `ended` says why to stop.

    None with a position before the age of a stream's pictures is known: it would be of another place.
    """
    camera_state, vehicle, warned = "", autopilot.vehicle, False
    awaiting: ExposureQueue[tuple[Frame, float | None]] = ExposureQueue(autopilot.history)
    # On a terminal only: the log of a service needs no counter.
    with tqdm(unit=" frames", disable=None) as counter:
        while (why := ended()) is None:
            autopilot.poll()
            frame = camera.take(TURN_S)
            if frame is not None:
                now_ns = time.monotonic_ns()
                own = vehicle.position(now_ns)
                frame = pictures.dated(frame, vehicle.motion.speed_mps(now_ns), own)
                why_not = pictures.why_undated if own is not None else ""
                distance_m = vehicle.motion.distance_m(frame.stamp_ns)
                if not why_not and sampler.is_place(frame.stamp_ns, distance_m):
                    awaiting.add(frame.stamp_ns, (frame, distance_m))
                if why_not and not warned:
                    log.warning("nothing is recorded yet: %s", why_not)
                warned = bool(why_not)
            for waited, position in awaiting.known():
                recorder.record(*waited, position)
            counter.update(recorder.written - counter.n)
            camera_state = _log_camera(camera, camera_state)
    for waited, position in awaiting.known(all_of_them=True):
        recorder.record(*waited, position)
    return why


def _log_camera(camera: NewestFrame, logged: str) -> str:
    """Write a line to the log when the camera's state is another than the one logged last; returns the state."""
    health = camera.health
    if health.state != logged:
        for line in (health.reason, *health.differences):
            if line:
                log.warning("camera %s: %s", health.state, line)
    return health.state


def _run(args: argparse.Namespace) -> int:
    config = load_config(args.config)
    stop = threading.Event()
    with on_stop_signal(stop.set), naming(args.config):
        done = record(config, args.output, stop, duration_s=args.duration, min_free_bytes=args.min_free_mb * 1e6)
    log.info("%s: %d frames, %d with a position; %s", args.output, done.frames, done.with_position, done.why)
    if done.skipped:
        log.warning("%s: %d frames were skipped because the disk is too slow", args.output, done.skipped)
    return 1 if done.why == "disk nearly full" else 0
