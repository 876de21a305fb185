"""Frames while `lookback map learn` runs as the daemon runs it, against those while it is stopped: wall-clock times."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edge.config import Config, MapConfig
from edge.descriptor.network import Network
from edge.recognizer import model_key, open_recognizer
from edge.sequence import Travel
from edge_plugins.layers.learner import learn_command
from sim.bench.frames import SIZE_PX, smooth_picture
from sim.bench.simulated_map import SPACING_M, write_simulated_map
from sim.bench.timing import time_ms, wall_ns

DRIVES, LAYERS, PLACES = 8, 4, 10_000
"""Places that are searched; each drive that is learned from has a fourth of them, 5 km."""
FRAME_S, BLOCK = 0.05, 20
ROUNDS, FRAMES = 7, 200
TAIL = 0.99
Floats = NDArray[np.float64]


class Learning:
    """The command, begun anew whenever it has ended, and stopped between blocks."""

    def __init__(self, folder: Path, layers: int = LAYERS) -> None:
        """folder: of maps."""
        self._command = learn_command(folder, layers)
        self._process = self._begun()

    @property
    def pid(self) -> int:
        """Of the process."""
        return self._process.pid

    def _begun(self) -> subprocess.Popen[bytes]:
        return subprocess.Popen(self._command, stdout=subprocess.DEVNULL)

    def keep_running(self) -> None:
        """Begin it where it has ended."""
        if self._process.poll() is not None:
            self._process = self._begun()

    @contextmanager
    def stopped(self) -> Iterator[None]:
        """Let it stand still meanwhile."""
        os.kill(self.pid, signal.SIGSTOP)
        try:
            yield
        finally:
            os.kill(self.pid, signal.SIGCONT)

    def close(self) -> None:
        """End it."""
        self._process.kill()
        self._process.wait()


def frames_rows(folder: Path, network: Network) -> Iterator[str]:
    """A row for what runs beside the frames: medians of the rounds."""
    for drive in range(DRIVES):
        write_simulated_map(folder / "learned" / f"{drive}", PLACES // LAYERS + drive, model_key(network))
    path = folder / "searched"
    write_simulated_map(path, PLACES, model_key(network))
    recognizer = open_recognizer(Config(map=MapConfig(path=str(path), places_per_frame=2 * PLACES)), network=network)
    rng, number = np.random.default_rng(1), count()
    pictures = [smooth_picture(rng, SIZE_PX) for _ in range(64)]
    learning = Learning(folder / "learned")

    def observe() -> None:
        frame = next(number)
        recognizer.observe(pictures[frame % len(pictures)], frame * 50_000_000, Travel(frame * SPACING_M))

    def block(*, beside: bool) -> list[float]:
        """Milliseconds of each of the next frames, with the command beside them or without."""
        times_ms, due_s = [], time.monotonic()
        for _ in range(BLOCK):
            if beside:
                learning.keep_running()
            due_s += FRAME_S
            time.sleep(max(0.0, due_s - time.monotonic()))
            times_ms.append(time_ms(observe, wall_ns))
        return times_ms

    rounds: list[Floats] = []
    used_s, learning_s = _used_by_children_s(), 0.0
    try:
        block(beside=True)
        for _ in range(ROUNDS):
            blocks = []
            for _ in range(max(1, FRAMES // BLOCK)):
                with learning.stopped():
                    alone_ms = block(beside=False)
                began_s = time.monotonic()
                blocks.append((alone_ms, block(beside=True)))
                learning_s += time.monotonic() - began_s
            rounds.append(np.array(blocks).swapaxes(0, 1).reshape(2, -1))
    finally:
        learning.close()
    yield from table(np.array(rounds), (_used_by_children_s() - used_s) / learning_s)


def _used_by_children_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def table(rounds_ms: Floats, share: float) -> Iterator[str]:
    """rounds_ms: (rounds, 2, frames), without the command and with it. share: of a core, that it had."""
    yield "| `map learn` | median frame | over that without | 99 % of frames, over the median without |"
    yield "|---|---|---|---|"
    medians_ms = np.median(rounds_ms, axis=2)
    tails = np.quantile(rounds_ms, TAIL, axis=2) / medians_ms[:, :1]
    for number, what in enumerate(("is stopped", f"runs, with {share:.2f} of a core")):
        ms, over = np.median(medians_ms[:, number]), np.median(medians_ms[:, number] / medians_ms[:, 0])
        yield f"| {what} | {ms:.0f} ms | {over:.2f} | {np.median(tails[:, number]):.2f} |"
