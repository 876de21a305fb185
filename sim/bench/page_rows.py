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
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil

from edge.errors import FeedError
from edge.reference_map.store import ModelKey
from edge.telemetry.page import HTML
from sim.bench.memory_rows import start_daemon, write_pictures
from sim.bench.rows import Row, Section, Target
from sim.bench.simulated_map import write_simulated_map

PERIODS_MS = (50, 200)
LIMIT = 1.05
LOADED_S = 8.0
KINDS = ("no page", "nobody looks", "somebody looks")


def measure(folder: Path, places: int, measured_s: float, rounds: int, model: ModelKey) -> Section:
    """CPU time at each rate of used frames, on a simulated map."""
    write_simulated_map(folder / "page.map", places, model)
    rows, ratios = [], []
    for period_ms in PERIODS_MS:
        feed = folder / f"page_{period_ms}"
        write_pictures(feed, round((LOADED_S + measured_s) * 1000 / period_ms) + 40, period_ms)
        used = [{kind: _share(folder, feed, period_ms, kind, measured_s) for kind in KINDS} for _ in range(rounds)]
        unwatched, looked_at = (statistics.median(one[kind] / one[KINDS[0]] for one in used) for kind in KINDS[1:])
        ratios.append(looked_at / unwatched)
        ms = {kind: 1e3 * statistics.median(one[kind] for one in used) for kind in KINDS}
        note = ", ".join(f"{kind} {took:.0f}" for kind, took in ms.items()) + " ms of CPU a second"
        what = f"{1000 // period_ms} used frames a second: {100 * (ratios[-1] - 1):+.1f} % while somebody looks"
        rows.append(Row(f"{what}, {100 * (unwatched - 1):+.1f} % while nobody does", note=note))
    value = ", ".join(f"{100 * (ratio - 1):+.1f} %" for ratio in ratios)
    rates = " and ".join(str(1000 // period_ms) for period_ms in PERIODS_MS)
    target = Target(
        f"the live page, looked at, {rates} used frames a second", "5 % of the CPU or less", value, max(ratios) <= LIMIT
    )
    return Section(f"The live page of `lookback run`, {places:,} places", rows, [target])


def _share(folder: Path, feed: Path, period_ms: int, kind: str, measured_s: float) -> float:
    """Seconds of CPU a second of the daemon's process."""
    port = 0 if kind == KINDS[0] else _free_port()
    process = start_daemon(folder, feed, folder / "page.map", period_ms, port)
    watched = psutil.Process(process.pid)
    try:
        with _looker(port) if kind == KINDS[-1] else contextlib.nullcontext():
            time.sleep(LOADED_S)
            before_s, begun_s = _cpu_s(watched), time.monotonic()
            time.sleep(measured_s)
            return (_cpu_s(watched) - before_s) / (time.monotonic() - begun_s)
    except psutil.Error:
        said = process.communicate()[1]
        raise FeedError(f"lookback run ended with {process.returncode}: {said.strip()[-300:]}") from None
    finally:
        process.terminate()
        process.communicate()


def _cpu_s(process: psutil.Process) -> float:
    times = process.cpu_times()
    return float(times.user + times.system)


def _free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])


@contextlib.contextmanager
def _looker(port: int) -> Iterator[None]:
    """A thread that looks at the page until the context ends."""
    stop = threading.Event()
    thread = threading.Thread(target=_look, args=(port, stop), name="looker")
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


def _look(port: int, stop: threading.Event) -> None:
    """As the page does: the status with what is new and the picture, and the place where it is another."""
    rate = {name: float(value) for name, value in re.findall(r"\b([A-Z_]+) = (\d+)", HTML.read_text("utf-8"))}
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=5)
    since, place, pause_ms = 0, None, rate["SOONEST_MS"]
    while not stop.wait(pause_ms / 1000):
        try:
            status: dict[str, Any] = json.loads(_get(connection, f"/status.json?since={since}&shown={since}"))
            if status["history"]:
                since = status["history"][-1][0]
            match = status["match"]
            if match and match["place"] != place:
                place = match["place"]
                _get(connection, f"/place/{place}.jpg")
        except (OSError, http.client.HTTPException):
            connection.close()  # it is not up yet; the next request opens it again
            continue
        every_ms = 1000 * rate["FRAMES_A_LOOK"] / status["fps"] if status["fps"] else rate["LATEST_MS"]
        pause_ms = min(rate["LATEST_MS"], max(rate["SOONEST_MS"], every_ms))
    connection.close()


def _get(connection: http.client.HTTPConnection, path: str) -> bytes:
    connection.request("GET", path)
    return connection.getresponse().read()
