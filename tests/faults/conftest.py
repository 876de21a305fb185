"""The fault bench: faults at the real boundary, with seeds and figures.

Quick sizes run with all other tests, from the same seed every time; the full ones with `make soak`, from a new seed
each time. Each test reports what it measured at the end of the run, and a failing one how to repeat it:
LOOKBACK_SEED=... and its own name.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import zlib
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w

from edge_plugins.mapping.builder import Place
from sim.evaluation.memoizing_network import MemoizingNetwork
from tests.faults.daemon_process import Process
from tests.faults.simulated_daemon import DaemonRig, ScriptedFrames
from tests.map_of import map_of

FIGURE = "fault bench"
PERIOD_MS = 40


def pytest_terminal_summary(terminalreporter: Any) -> None:
    calls = [
        report
        for reports in terminalreporter.stats.values()
        for report in reports
        if isinstance(report, pytest.TestReport) and report.when == "call"
    ]
    measured = [(call, value) for call in calls for name, value in call.user_properties if name == FIGURE]
    if measured:
        terminalreporter.section(FIGURE)
    for call, value in measured:
        terminalreporter.write_line(f"{call.nodeid.rpartition('::')[2]}: {value}")


@pytest.fixture
def figures(record_property: Callable[[str, object], None]) -> Callable[[str], None]:
    """Reports what a test measured, at the end of the run, from whichever worker ran it."""
    return lambda line: record_property(FIGURE, line)


@pytest.fixture
def seed(request: pytest.FixtureRequest) -> int:
    """The test's own seed, the same in every run unless LOOKBACK_SEED names another."""
    value = int(os.environ.get("LOOKBACK_SEED") or zlib.crc32(request.node.name.encode()))
    print(f"again: LOOKBACK_SEED={value} python -m pytest -m '' '{request.node.nodeid}'")
    return value


class ProcessNumbers:
    """What /proc says of a process."""

    def resident_bytes(self, pid: int | str = "self") -> int:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")

    def open_descriptors(self, pid: int | str = "self") -> int:
        return len(list(Path(f"/proc/{pid}/fd").iterdir()))


@pytest.fixture
def proc() -> ProcessNumbers:
    return ProcessNumbers()


@pytest.fixture(scope="session")
def make_map() -> Callable[..., Path]:
    """Writes a map of made-up descriptors; 12 places of 2 x 16 values unless told otherwise."""

    def make(path: Path, places: int = 12, dimensions: int = 16, seed: int = 0, *, replace: bool = False) -> Path:
        rng = np.random.default_rng(seed)
        raw = np.maximum(rng.normal(size=(places, 2, dimensions)), 0)
        known = [Place(row, -27.0 + row * 2e-5, 153.0, 10.0, 0.0, 2.0 * row, b"picture" * 9) for row in range(places)]
        return map_of(path, raw, known, view="rear", replace=replace).path

    return make


@pytest.fixture(scope="session")
def street(make_street: Callable[..., Path]) -> Path:
    return make_street(period_ms=PERIOD_MS)


@pytest.fixture(scope="session")
def calm_feed(street: Path, play_on: Callable[[Path, Path], Path]) -> Path:
    """The street over and over."""
    return play_on(street / "feed", street / "calm")


@pytest.fixture(scope="session")
def compile_shim(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Compiles NAME.c of this folder to a library that LD_PRELOAD puts between a process and its C library."""

    def compile_one(name: str) -> Path:
        compiler = shutil.which("cc") or shutil.which("gcc")
        if compiler is None:
            pytest.skip("needs a C compiler")
        library, source = tmp_path_factory.mktemp("shim") / f"{name}.so", Path(__file__).with_name(f"{name}.c")
        subprocess.run([compiler, "-shared", "-fPIC", "-O2", "-o", str(library), str(source), "-ldl"], check=True)
        return library

    return compile_one


@pytest.fixture
def write_config(street: Path, tmp_path: Path) -> Callable[..., Path]:
    """Writes a configuration for the street's feed and map; sections are changed by keyword."""

    def write(folder: Path = tmp_path, **sections: dict[str, Any]) -> Path:
        settings: dict[str, dict[str, Any]] = {
            "camera": {"kind": "feed", "device": str(street / "feed")},
            "sampling": {"by": "frames"},
            "map": {"path": str(street / "map")},
            "sequence": {"length": 10},
            "acceptance": {"uniqueness_min": 1.02, "window_m": 10.0, "hold_off_s": 0.2},
            "telemetry": {"connection": "udp:127.0.0.1:9", "journal": "events.jsonl"},
            "page": {"port": 0},
        }
        for name, changes in sections.items():
            settings[name] = {**settings.get(name, {}), **changes}
        path = folder / "lookback.toml"
        path.write_text(tomli_w.dumps(settings))
        return path

    return write


@pytest.fixture
def start(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[..., Process]]:
    """Starts daemons, and ends what a test has left running."""
    running: list[Process] = []

    def start_one(
        config: Path,
        *,
        environment: dict[str, str] | None = None,
        wrapper: list[str] | None = None,
        manager_reads: bool = True,
    ) -> Process:
        folder = tmp_path_factory.mktemp("run")
        running.append(Process(config, folder, environment or {}, wrapper or [], manager_reads))
        return running[-1]

    yield start_one
    for process in running:
        process.close()


@pytest.fixture
def make_bench(grid: MemoizingNetwork) -> Iterator[Callable[..., DaemonRig]]:
    with ExitStack() as parts:
        yield lambda config, network=grid, speed_mps=10.0, frames=ScriptedFrames: DaemonRig(
            config, parts, network, speed_mps, frames
        )
