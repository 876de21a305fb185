"""What the live page costs the daemon: CPU time of `lookback run` with no page, unwatched, and looked at.

The three run in turns on the same recording. The looker asks for what the page asks for and as often, by the constants
in the page itself. CPU time is of the process, over the middle of the run: neither start nor end.
"""

from __future__ import annotations

import contextlib
import http.client
import json
import re
import socket
import statistics
import subprocess
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil

from edge.errors import FeedError
from edge.page.server import HTML
from edge.reference_map.store import ModelKey
from sim.bench.memory_rows import JOURNAL, start_daemon, write_pictures
from sim.bench.rows import Row, Section, Target
from sim.bench.simulated_map import write_simulated_map

PERIODS_MS = (50, 200)
LIMIT = 0.05
SETTLED_S = 4.0
START_S = 60.0  # at most, on a busy computer
KINDS = ("no page", "nobody looks", "somebody looks")


@dataclass(frozen=True)
class Run:
    """Seconds of CPU a second of the daemon's process, and how often it was looked at meanwhile."""

    share: float
    looks: int


def measure(
    folder: Path,
    places: int,
    measured_s: float,
    rounds: int,
    model: ModelKey,
    periods_ms: Sequence[int] = PERIODS_MS,
    settled_s: float = SETTLED_S,
) -> Section:
    """CPU time at each rate of used frames, on a simulated map."""
    write_simulated_map(folder / "page.map", places, model)
    rows, shares = [], []
    for period_ms in periods_ms:
        write_pictures(folder / f"page_{period_ms}", round((START_S + measured_s) * 1000 / period_ms), period_ms)
        runs = [{kind: _run(folder, period_ms, kind, settled_s, measured_s) for kind in KINDS} for _ in range(rounds)]
        nobody, somebody = (
            statistics.median(run[kind].share / run[KINDS[0]].share for run in runs) - 1 for kind in KINDS[1:]
        )
        shares.append(somebody)
        shares_ms = [f"{kind} {1e3 * statistics.median(run[kind].share for run in runs):.0f}" for kind in KINDS]
        looks = statistics.median(run[KINDS[-1]].looks for run in runs)
        note = f"{', '.join(shares_ms)} ms of CPU a second; {looks:g} looks in {measured_s:g} s"
        what = f"{1000 // period_ms} used frames a second"
        rows.append(Row(f"{what}: {somebody:+.1%} while somebody looks, {nobody:+.1%} while nobody does", note=note))
    value = ", ".join(f"{share:+.1%}" for share in shares)
    rates = " and ".join(str(1000 // period_ms) for period_ms in periods_ms)
    what = f"the live page, looked at, {rates} used frames a second"
    target = Target(what, "5 % of the CPU or less", value, max(shares) <= LIMIT)
    return Section(f"The live page of `lookback run`, {places:,} places", rows, [target])


def _run(folder: Path, period_ms: int, kind: str, settled_s: float, measured_s: float) -> Run:
    port = 0 if kind == KINDS[0] else _free_port()
    (folder / JOURNAL).unlink(missing_ok=True)
    process = start_daemon(folder, folder / f"page_{period_ms}", folder / "page.map", period_ms, port)
    watched = psutil.Process(process.pid)
    looks: list[float] = []
    try:
        _wait_for_start(folder, process)
        with _looker(port, looks) if kind == KINDS[-1] else contextlib.nullcontext():
            time.sleep(settled_s)
            before_s, begun_s = _cpu_s(watched), time.monotonic()
            time.sleep(measured_s)
            share = (_cpu_s(watched) - before_s) / (time.monotonic() - begun_s)
            return Run(share, sum(look_s >= begun_s for look_s in looks))
    except psutil.Error:
        raise FeedError(f"lookback run ended: {process.communicate()[1].strip()[-300:]}") from None
    finally:
        process.terminate()
        process.communicate()


def _wait_for_start(folder: Path, process: subprocess.Popen[str]) -> None:
    """Until the daemon has written its first line. FeedError if it ends before."""
    deadline_s = time.monotonic() + START_S
    while not (folder / JOURNAL).exists() or not (folder / JOURNAL).stat().st_size:
        if process.poll() is not None or time.monotonic() > deadline_s:
            process.terminate()
            raise FeedError(f"lookback run did not start: {process.communicate()[1].strip()[-300:]}")
        time.sleep(0.05)


def _cpu_s(process: psutil.Process) -> float:
    times = process.cpu_times()
    return float(times.user + times.system)


def _free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])


@contextlib.contextmanager
def _looker(port: int, looks: list[float]) -> Iterator[None]:
    """A thread that looks at the page until the context ends, and notes when it did."""
    stop = threading.Event()
    thread = threading.Thread(target=_look, args=(port, stop, looks), name="looker")
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


def _look(port: int, stop: threading.Event, looks: list[float]) -> None:
    """As the page does: the status with what is new and the picture, and the place where it is another."""
    rate = {name: float(value) for name, value in re.findall(r"\b([A-Z_]+) = (\d+)", HTML.read_text("utf-8"))}
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=5)
    since, place, pause_ms = 0, None, rate["SOONEST_MS"]
    while not stop.wait(pause_ms / 1000):
        try:
            status: dict[str, Any] = json.loads(_get(connection, f"/status.json?since={since}&shown={since}"))
            if status["history"]:
                since = status["history"][-1]["used"]["stamp_ns"]
            newest = status["newest"]
            if newest and newest["place"] not in (None, place):
                place = newest["place"]  # of a single map, where rows are counted as they are
                _get(connection, f"/thumbnail/{place}.jpg")
        except (OSError, http.client.HTTPException):
            connection.close()  # it is not up yet; the next request opens it again
            continue
        looks.append(time.monotonic())
        every_ms = 1000 * rate["FRAMES_A_LOOK"] / status["fps"] if status["fps"] else rate["LATEST_MS"]
        pause_ms = min(rate["LATEST_MS"], max(rate["SOONEST_MS"], every_ms))
    connection.close()


def _get(connection: http.client.HTTPConnection, path: str) -> bytes:
    connection.request("GET", path)
    return connection.getresponse().read()
