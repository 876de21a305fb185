"""`lookback run` from the camera on: the processor's time that it takes in a second of driving.

The camera is a recording of JPEG pictures, which cost what those of a USB camera do. Beside a frame's stages this has
all that comes before and around them: decoding, the checks of pictures, and turns of the loop without a picture.
"""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TypeAlias

import cv2
import numpy as np
import tomli_w
from numpy.typing import NDArray

from edge.camera.frame import CameraHealth
from edge.camera.recorded import RecordedCamera
from edge.config import Config, DescriptorConfig, load_config
from edge.daemon import Daemon
from edge.descriptor.open_network import open_network
from edge.errors import LookbackError
from edge.feed import FeedHeader, FeedRow, Frame, read_feed
from edge.feed.writer import JPEG_QUALITY, FeedWriter
from edge.opened_parts import OpenedParts
from edge.recognizer import model_key
from sim.bench.frames import smooth_picture
from sim.bench.simulated_map import write_simulated_map
from sim.bench.timing import Times, race, wall_ns
from sim.research.bench.rows import Row, Section

Size: TypeAlias = tuple[int, int]

USED_HZ, QUICK_HZ = 5, 15
"""Rates of the camera; at either so many frames a second are used."""
PICTURES, GRAIN = 20, 4.0
"""Pictures that come round again, and the noise in them: their files are as large as those of a street."""
BEGUN_S = 4
"""Seconds in which the daemon checks its map and fills its sequence, before its time is measured."""
LENGTH = 10
"""Frames of a sequence: what a frame costs does not depend on it."""
STARTS = 3


def measure(folder: Path, places: int, seconds: int, models: Sequence[str], sizes: Sequence[Size]) -> Section:
    """Lines for each network, and a column for each size of the pictures (width, height); LookbackError."""
    rows: list[Row] = []
    columns = {f"{width}x{height}": (width, height) for width, height in sizes}
    for column, size in columns.items():
        _write_pictures(folder / column, size)
        rows.append(Row("decoding one picture", _decoding(size), size=column))
    for model in models:
        path = folder / f"{model}.map"
        write_simulated_map(path, places, model_key(open_network(DescriptorConfig(model=model))))
        for column in columns:
            with ExitStack() as parts:
                driven: dict[str, _Driven] = {}
                for hz in (USED_HZ, QUICK_HZ):
                    file = _write_config(folder / column, path, model, hz, BEGUN_S + 1 + seconds)
                    daemon = _Driven(load_config(file), parts)
                    for _ in range(BEGUN_S):
                        daemon.second()
                    driven[f"{model}: a second of {hz} pictures, {USED_HZ} of them used"] = daemon
                taken = race({what: one.second for what, one in driven.items()}, seconds, time.process_time_ns)
                for daemon in driven.values():
                    daemon.check()
            rows += [Row(what, times, size=column) for what, times in taken.items()]
            slow, quick = (times.runs_ms for times in taken.values())
            unused = ((more - less) / (QUICK_HZ - USED_HZ) for less, more in zip(slow, quick, strict=True))
            rows.append(Row(f"{model}: one picture that is not used", Times(tuple(unused)), size=column))
        start = race({"start": partial(_start, file)}, STARTS, wall_ns)["start"]
        rows.append(Row(f"{model}: start to the first picture used, wall-clock", start, size=column))
        shutil.rmtree(path)
    return Section(f"`lookback run` from the camera on, {places:,} places: CPU time of all threads", rows, [])


def _pictures(size: Size) -> Iterator[NDArray[np.uint8]]:
    rng = np.random.default_rng(0)
    for _ in range(PICTURES):
        grain = rng.normal(0, GRAIN, (size[1], size[0], 3)).astype(np.int16)
        yield (smooth_picture(rng, size) + grain).clip(0, 255).astype(np.uint8)


def _decoding(size: Size) -> Times:
    file = cv2.imencode(".jpg", next(_pictures(size)), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1]
    return race({"decode": lambda: cv2.imdecode(file, cv2.IMREAD_COLOR)}, PICTURES)["decode"]


def _write_pictures(feed: Path, size: Size) -> None:
    with FeedWriter(feed, FeedHeader("camera", "front", *size)) as writer:
        for number, picture in enumerate(_pictures(size)):
            writer.write(picture, FeedRow("", number))


def _write_config(feed: Path, map_path: Path, model: str, hz: int, seconds: int) -> Path:
    """Of a daemon whose camera shows the pictures again and again."""
    rows = [f"frames/{number % PICTURES:06d}.jpg,{number * 10**9 // hz}" for number in range(hz * seconds)]
    (feed / "frames.csv").write_text("\n".join(["file,stamp_ns", *rows]), encoding="utf-8")
    config = {
        "camera": {"kind": "feed", "device": str(feed)},
        "descriptor": {"model": model},
        "map": {"path": str(map_path)},
        "sampling": {"by": "frames", "spacing_frames": hz // USED_HZ},
        "sequence": {"length": LENGTH},
        "telemetry": {"connection": f"udpin:127.0.0.1:{_free_port()}", "journal": str(feed / f"events-{hz}.jsonl")},
        "page": {"port": 0},
    }
    (feed / "lookback.toml").write_text(tomli_w.dumps(config), encoding="utf-8")
    return feed / "lookback.toml"


class _Camera:
    """`NewestFrame` in time that passes only while the daemon waits: a busy computer loses no picture."""

    def __init__(self, feed: Path) -> None:
        self.now_ns = 0
        self.health = CameraHealth("running", "", 0)
        self._due_ns = [row.stamp_ns for row in read_feed(feed).rows]
        self._camera = RecordedCamera(read_feed(feed), lambda: self.now_ns, self._wait)

    def _wait(self, seconds: float) -> None:
        self.now_ns += round(seconds * 1e9)

    @property
    def ended(self) -> bool:
        return self.health.delivered == len(self._due_ns)

    def take(self, timeout_s: float) -> Frame | None:
        if self.ended or self._due_ns[self.health.delivered] > self.now_ns + timeout_s * 1e9:
            self._wait(timeout_s)
            return None
        self.health = replace(self.health, delivered=self.health.delivered + 1)
        return self._camera.read()

    def close(self) -> None:
        self._camera.close()


class _Driven:
    """A daemon, driven second by second; two of them in turns are alike affected by other load."""

    def __init__(self, config: Config, parts: ExitStack) -> None:
        self._camera, self._second = _Camera(Path(config.camera.device)), 0
        self._daemon = Daemon(OpenedParts(config, parts, lambda: self._camera.now_ns, frames=self._camera))

    def second(self) -> None:
        """The next second of the drive."""
        self._second += 1
        while self._camera.now_ns < self._second * 1_000_000_000:
            self._daemon.turn()

    def check(self) -> None:
        """All pictures that are to be used were used."""
        wanted = USED_HZ * self._second
        assert self._daemon.last_words().frames_used == wanted, f"{wanted} pictures are to be used"


def _start(config: Path) -> None:
    """Start `lookback run`, and return with its READY=1: it has used its first picture. LookbackError."""
    address, log = config.with_name("notify"), config.with_name("log")
    address.unlink(missing_ok=True)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager, log.open("w") as stderr:
        manager.bind(str(address))
        manager.settimeout(0.1)
        command, environment = [sys.executable, "-m", "edge", "run", str(config)], {"NOTIFY_SOCKET": str(address)}
        with subprocess.Popen(command, env={**os.environ, **environment}, stderr=stderr) as daemon:
            while daemon.poll() is None:
                with suppress(TimeoutError):
                    if manager.recv(4096) == b"READY=1":
                        daemon.kill()
                        return
    raise LookbackError(f"the daemon does not start: {log.read_text(encoding='utf-8').strip()}")


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])
