"""Scenarios of the simulator as feeds: rendered when they are first needed, and kept."""

from __future__ import annotations

import hashlib
from pathlib import Path

import msgspec
from tqdm import tqdm

import edge
from edge.config import SamplingConfig
from sim.evaluation.plan import TraversePlan
from sim.world.recording import times_by_distance, times_by_rate, write_feed
from sim.world.scenario import load_scenario


def feed_of(name: str, plan: TraversePlan, folder: Path, rendered: Path, sampling: SamplingConfig) -> Path:
    """The feed of a scenario, in `rendered` under a name that has a hash of all that decides what it shows.

    A feed that was broken off does not count: it has its last name only when it is whole.
    """
    scenario = load_scenario(folder / plan.scenario)
    spacing_m = sampling.spacing_m
    decides = msgspec.json.encode([scenario, plan.fps or spacing_m, edge.__version__])
    path = rendered / f"{name}-{hashlib.sha256(decides).hexdigest()[:12]}"
    if path.is_dir():
        return path
    part = path.with_suffix(".part")
    _remove(part)
    drive = scenario.drive()
    times_s = times_by_rate(drive, plan.fps) if plan.fps else times_by_distance(drive, spacing_m)
    write_feed(scenario, drive, part, tqdm(times_s, desc=f"rendering {name}", unit="frame", leave=False))
    part.rename(path)
    return path


def _remove(folder: Path) -> None:
    """Take away what a broken-off rendering left."""
    for file in sorted(folder.rglob("*"), reverse=True):
        file.rmdir() if file.is_dir() else file.unlink()
    if folder.is_dir():
        folder.rmdir()
