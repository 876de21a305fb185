"""`lookback dev paper networks`: networks side by side on a user's own traverses, in one table.

Accuracy and max-F1 are those of NSD-CR, the paper's method, R@P100 is that of the place belief of `lookback run`. Time
and memory are measured on this computer, each network in a process of its own.
"""

from __future__ import annotations

import argparse
import resource
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from statistics import fmean, median

import msgspec
import numpy as np
from tqdm import tqdm

from edge.errors import ConfigError
from edge.reference_map.place_records import PLACE
from sim.bench.timing import time_ms
from sim.evaluation.report import Cell, Section, Table, write_report
from sim.research.evaluation.comparison import table_of
from sim.research.evaluation.networks import open_network
from sim.research.evaluation.plan import NetworkPlan, Plan, load_plan
from sim.research.evaluation.run import about, find_plan, folders_of, open_runner
from sim.research.evaluation.scores import scores

METHOD, BELIEF = "NSD-CR", "Lookback"
REGIONS, ROUNDS = 2, 60


@dataclass(frozen=True)
class Cost:
    """What a network takes here: CPU time of a frame of two regions, and resident memory with its file open."""

    time_ms: float
    memory_mb: float


def run(args: argparse.Namespace) -> int:
    """Compare the networks of a plan and those of --model, and write the report."""
    path = find_plan(args.plan)
    plan = _with_networks(load_plan(path), args.model)
    folders = folders_of(args, path)
    runner = open_runner(plan, folders)
    opened = {name: open_network(name, one, folders.models, "fc6") for name, one in plan.networks.items()}
    rows: list[dict[str, Cell]] = []
    for name in tqdm(opened, desc="networks", unit="network"):
        found, beliefs = (
            [scores(runner.run(pair, f"{method}@{name}").answers) for pair in plan.pairs] for method in (METHOD, BELIEF)
        )
        info, cost = opened[name].info, measured(name, plan.networks[name], folders.models)
        rows.append(
            {
                "network": name,
                "accuracy": fmean(one.accuracy for one in found),
                "max-F1": fmean(one.max_f1_of_places for one in found),
                "R@P100 of the belief": fmean(one.recall_at_100 for one in beliefs),
                "time, ms": f"{cost.time_ms:.2f}",
                "memory, MB": f"{cost.memory_mb:.0f}",
                "file, MB": f"{opened[name].path.stat().st_size / 1e6:.1f}",
                "dimensions": info.dimensions,
                # While it is matched: int8 of both regions, and its record.
                "map, bytes a place": REGIONS * info.dimensions + PLACE.itemsize,
                "license": info.license.partition(",")[0],
            }
        )
        runner.descriptions.forget(name)
    note = (
        f"Means over {len(plan.pairs)} pair(s). Accuracy: share of right best matches of {METHOD}. Time: CPU time of"
        " the two regions of a frame. Memory: what the process grows by when it opens and runs the network."
    )
    table = table_of("networks", "Networks side by side", rows, note)
    sections = [Section("Networks", tables=[table])]
    page = write_report(args.output, f"Networks: {plan.title}", about(path, plan, runner), sections)
    print(as_markdown(table))
    print(page)
    return 0


def _with_networks(plan: Plan, given: Sequence[str]) -> Plan:
    """The plan with the networks NAME=PATH as well; ConfigError for other text."""
    networks = dict(plan.networks)
    for text in given:
        name, equals, path = text.partition("=")
        if not (name and equals) or "@" in name:
            raise ConfigError(f"--model: {text!r} is not NAME=PATH")
        networks[name] = NetworkPlan(model=str(Path(path).resolve()) if path else "")
    return msgspec.structs.replace(plan, networks=networks)


def measured(name: str, plan: NetworkPlan, folder: Path) -> Cost:
    """The cost of a network, in a process that has nothing else to do."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(_measure, name, plan, folder).result()


def _measure(name: str, plan: NetworkPlan, folder: Path) -> Cost:
    before_mb = _resident_mb()
    network = open_network(name, plan, folder, "fc6")
    pictures = 1 if network.info.columns else REGIONS
    images = np.random.default_rng(0).integers(0, 256, (pictures, *network.size, 3), dtype=np.uint8)
    time_of_frame_ms = median(time_ms(lambda: network.describe(images)) for _ in range(ROUNDS))
    return Cost(time_of_frame_ms, _resident_mb() - before_mb)


def _resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() / 1e6


def as_markdown(table: Table) -> str:
    """The table as the docs have it."""

    def cells(row: Sequence[Cell]) -> str:
        return "| " + " | ".join(f"{cell:.2f}" if isinstance(cell, float) else str(cell) for cell in row) + " |"

    return "\n".join([cells(table.columns), "|" + "---|" * len(table.columns), *map(cells, table.rows)])
