"""Frames while `lookback map learn` runs as the daemon runs it, against those while it is stopped: wall-clock times."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from edge.config import Config, MapConfig
from edge.descriptor.network import Network
from edge.layers import learn_command
from edge.recognizer import PlaceRecognizer, model_key, open_recognizer
from edge.sequence import Travel
from sim.bench.frames import SIZE_PX, smooth_picture
from sim.bench.simulated_map import SPACING_M, write_simulated_map
from sim.bench.timing import Times, time_ms, wall_ns
from sim.research.bench.rows import Row, Section, Target

DRIVES, LAYERS = 8, 4
FRAME_S, BLOCK = 0.05, 20
ROUNDS = 5
TAIL, MOST_TIMES = 0.99, 1.5


class Learning:
    """The command, begun anew whenever it has ended, and stopped between blocks."""

    def __init__(self, folder: Path) -> None:
        """folder: of maps."""
        self._command = learn_command(folder, LAYERS)
        self._process = self._begun()

    def _begun(self) -> subprocess.Popen[bytes]:
        return subprocess.Popen(self._command, stdout=subprocess.DEVNULL)

    def keep_running(self) -> None:
        """Begin it where it has ended."""
        if self._process.poll() is not None:
            self._process = self._begun()

    @contextmanager
    def stopped(self) -> Iterator[None]:
        """Let it stand still meanwhile."""
        os.kill(self._process.pid, signal.SIGSTOP)
        try:
            yield
        finally:
            os.kill(self._process.pid, signal.SIGCONT)

    def close(self) -> None:
        """End it."""
        self._process.kill()
        self._process.wait()


class _Frames:
    """A recognizer that gets a picture each FRAME_S."""

    def __init__(self, recognizer: PlaceRecognizer, pictures: Sequence[np.ndarray]) -> None:
        self._recognizer, self._pictures, self._count = recognizer, pictures, 0

    def block(self, learning: Learning | None) -> list[float]:
        """Milliseconds of each frame of a block. learning: what is to run meanwhile."""
        times_ms, due_s = [], time.monotonic()
        for _ in range(BLOCK):
            if learning is not None:
                learning.keep_running()
            due_s += FRAME_S
            time.sleep(max(0.0, due_s - time.monotonic()))
            times_ms.append(time_ms(self._observe, wall_ns))
        return times_ms

    def _observe(self) -> None:
        frame, self._count = self._count, self._count + 1
        picture = self._pictures[frame % len(self._pictures)]
        self._recognizer.observe(picture, frame * 50_000_000, Travel(frame * SPACING_M))


def measure(folder: Path, places: int, frames: int) -> Section:
    """The rows, and the target: the slowest of 100 frames takes at most MOST_TIMES a frame of one that runs alone."""
    network = Network.load()
    for drive in range(DRIVES):
        write_simulated_map(folder / "learned" / f"{drive}", places // LAYERS + drive, model_key(network))
    path = folder / f"learning_{places}.map"
    write_simulated_map(path, places, model_key(network))
    recognizer = open_recognizer(Config(map=MapConfig(path=str(path), places_per_frame=2 * places)), network=network)
    rng = np.random.default_rng(1)
    source, learning = (
        _Frames(recognizer, [smooth_picture(rng, SIZE_PX) for _ in range(64)]),
        Learning(folder / "learned"),
    )
    rounds: list[tuple[list[float], list[float]]] = []
    try:
        source.block(learning)
        for _ in range(ROUNDS):
            alone, beside = [], []
            for _ in range(max(1, frames // BLOCK)):
                with learning.stopped():
                    alone += source.block(None)
                beside += source.block(learning)
            rounds.append((alone, beside))
    finally:
        learning.close()
    return _section(rounds)


def _section(rounds: Sequence[tuple[list[float], list[float]]]) -> Section:
    """Of the frames of each round, alone and beside the command."""
    rows: list[Row] = []
    tails: list[float] = []
    for number, what in enumerate(("frame, `map learn` stopped", "frame, `map learn` runs")):
        times = Times(tuple(float(np.median(one[number])) for one in rounds))
        over = [float(np.quantile(one[number], TAIL) / np.median(one[0])) for one in rounds]
        tails.append(float(np.median(over)))
        ratio = times.ratio(Times(rows[0].times.runs_ms)) if rows and rows[0].times else None
        note = f"wall-clock; 99 % of frames within {tails[-1]:.2f} times the median of those beside nothing"
        rows.append(Row(what, times, "stopped" if number else "", ratio, note))
    target = Target(
        "99 % of frames while `map learn` runs, against the median of those without",
        f"{MOST_TIMES:g}x or less",
        f"{tails[1]:.2f}x ({tails[0]:.2f}x without)",
        tails[1] <= MOST_TIMES,
    )
    return Section("Frames while `map learn` runs", rows, [target])
