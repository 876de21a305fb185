"""What the live page costs the daemon: CPU time of `lookback run` with no page, unwatched, and looked at.

Unwatched and looked at are two halves of one run, since two runs of the same differ by more than the page costs; every
other run begins with the other half. The looker asks for what the page asks for and as often, by the constants in the
page itself. CPU time is of the process, over the middle of the run: neither start nor end.
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
from pathlib import Path
from typing import Any, NamedTuple

import psutil

from edge.errors import FeedError
from edge.page.server import HTML
from edge.reference_map.store import ModelKey
from sim.bench.simulated_map import write_simulated_map
from sim.research.bench.memory_rows import JOURNAL, start_daemon, write_pictures
from sim.research.bench.rows import Row, Section, Target

PERIODS_MS = (50, 200)
LIMIT = 0.05
SETTLED_S = 4.0
START_S = 60.0  # at most, on a busy computer


class Runs(NamedTuple):
    """Seconds of CPU a second of the daemon's process, and how often it was looked at in the last of the three."""

    no_page: float
    unwatched: float
    looked_at: float
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
        pictures = round((START_S + 2 * measured_s) * 1000 / period_ms)
        write_pictures(folder / f"page_{period_ms}", pictures, period_ms)
        runs = [_runs(folder, period_ms, settled_s, measured_s, looked_at_first=bool(i % 2)) for i in range(rounds)]
        shares.append(statistics.median(one.looked_at / one.unwatched for one in runs) - 1)
        unwatched = statistics.median(one.unwatched / one.no_page for one in runs) - 1
        parts_ms = [1e3 * statistics.median(values) for values in zip(*(one[:3] for one in runs), strict=True)]
        looks = statistics.median(one.looks for one in runs)
        note = "no page {:.0f}, nobody looks {:.0f}, somebody looks {:.0f} ms of CPU a second".format(*parts_ms)
        note += f"; {looks:g} looks in {measured_s:g} s"
        what = f"{1000 // period_ms} used frames a second"
        rows.append(
            Row(f"{what}: {shares[-1]:+.1%} while somebody looks, {unwatched:+.1%} while nobody does", note=note)
        )
    value = ", ".join(f"{share:+.1%}" for share in shares)
    rates = " and ".join(str(1000 // period_ms) for period_ms in periods_ms)
    what = f"the live page, looked at, {rates} used frames a second"
    target = Target(what, "5 % of the CPU or less", value, max(shares) <= LIMIT)
    return Section(f"The live page of `lookback run`, {places:,} places", rows, [target])


def _runs(folder: Path, period_ms: int, settled_s: float, measured_s: float, *, looked_at_first: bool) -> Runs:
    """One run without the page, and one with it, of two halves."""
    with _daemon(folder, period_ms, port=0) as watched:
        time.sleep(settled_s)
        no_page = _share(watched, measured_s)
    port = _free_port()
    shares: dict[bool, float] = {}
    looks: list[float] = []
    with _daemon(folder, period_ms, port) as watched:
        for is_looked_at in (looked_at_first, not looked_at_first):
            with _looker(port, looks) if is_looked_at else contextlib.nullcontext():
                time.sleep(settled_s)
                begun_s = time.monotonic()
                shares[is_looked_at] = _share(watched, measured_s)
                looks = [look_s for look_s in looks if look_s >= begun_s]
    return Runs(no_page, shares[False], shares[True], len(looks))


@contextlib.contextmanager
def _daemon(folder: Path, period_ms: int, port: int) -> Iterator[psutil.Process]:
    """A daemon that has started; FeedError if it ends within the context."""
    (folder / JOURNAL).unlink(missing_ok=True)
    process = start_daemon(folder, folder / f"page_{period_ms}", folder / "page.map", period_ms, port)
    try:
        _wait_for_start(folder, process)
        yield psutil.Process(process.pid)
    except psutil.Error:
        raise FeedError(f"lookback run ended: {process.communicate()[1].strip()[-300:]}") from None
    finally:
        process.terminate()
        process.communicate()


def _share(watched: psutil.Process, measured_s: float) -> float:
    """Seconds of CPU a second from now on."""
    before_s, begun_s = _cpu_s(watched), time.monotonic()
    time.sleep(measured_s)
    return (_cpu_s(watched) - before_s) / (time.monotonic() - begun_s)


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
