"""A whole frame after the camera, stage by stage, through the recognizer that the daemon runs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from edge.config import RigConfig
from edge.descriptor.network import Network
from edge.recognizer import model_key
from edge.sequence.place_search import MEASURED_SLOPES
from sim.bench.frames import SIZE_PX, run_frames
from sim.bench.simulated_map import write_simulated_map
from sim.bench.timing import Times, time_ms
from sim.research.bench.machine import read_all
from sim.research.bench.network_rows import floor_of
from sim.research.bench.rows import Row, Section, at_most

LANE = RigConfig(left_forward_m=3.5, left_reverse_m=3.5, parallax=2.4)
"""Beside the map's drive: the regions of two frames are matched together, and each region alone."""


def floors_of(places: int, dimensions: int) -> dict[str, Callable[[], object]]:
    """The stages that have a floor, and what takes as long as it: the bytes and products that no other way saves."""
    descriptors = np.ones(places * 2 * dimensions, dtype=np.int8)
    sums = np.zeros((MEASURED_SLOPES, 2, places), dtype=np.int32)
    return {
        "network": floor_of(2),
        "matching": lambda: read_all(descriptors),
        "search": lambda: np.add(sums, 1, out=sums),  # every running sum of 2 planes is read and written once
    }


def measure(folder: Path, places: int, frames: int) -> Section:
    """A row for each stage of the frames, and for all of them together; a stage without a floor is its own.

    The floors run after each frame: where the computer is slower for a while, both are, and no frame counts as slow.
    """
    network, path = Network.load(), folder / f"frames_{places}.map"
    write_simulated_map(path, places, model_key(network))
    racers = floors_of(places, network.info.dimensions)
    measured: list[dict[str, float]] = []
    floors: dict[str, list[float]] = {stage: [] for stage in racers}
    for frame in run_frames(path, places, frames, network, RigConfig()):
        measured.append(frame)
        for stage, racer in racers.items():
            floors[stage].append(time_ms(racer))
    in_lane = list(run_frames(path, places, frames, network, LANE))
    rows = []
    least = np.zeros(frames)
    for stage in measured[-1]:
        times = Times(tuple(frame.get(stage, 0.0) for frame in measured))
        floor = Times(tuple(floors[stage])) if stage in floors else None
        least += (floor or times).runs_ms
        of_floor = (f"its floor, {floor.median_ms:.2f} ms", times.ratio(floor)) if floor else ("", None)
        rows.append(Row(stage, times, *of_floor))
    whole = Times(tuple(sum(frame.values()) for frame in measured))
    slow, slowest = np.quantile(whole.runs_ms, (0.95, 0.99))
    each_over_floors = np.array(whole.runs_ms) / least
    over_floors = float(np.median(each_over_floors))
    tail = float(np.quantile(each_over_floors, 0.99)) / over_floors
    over = whole.ratio(Times(tuple(frame["network"] for frame in measured)))
    note = (
        f"{over_floors:.2f} times its floors, {np.median(least):.1f} ms; 95 % of frames within {slow:.1f} ms,"
        f" 99 % within {slowest:.1f} ms"
    )
    rows.append(Row("whole frame", whole, "its network", over, note))
    lane = Times(tuple(sum(frame.values()) for frame in in_lane))
    slower = lane.median_ms / whole.median_ms
    rows.append(Row("whole frame, in a lane beside the map's drive", lane, "whole frame", slower))
    targets = [
        at_most("whole frame, against its network", 2, over),
        at_most("whole frame, against the sum of its floors", 1.3, over_floors),
        at_most("whole frame: 99 % of frames over floors, against the median", 1.5, tail),
    ]
    return Section(f"Whole frame of {SIZE_PX[0]}x{SIZE_PX[1]}, {places:,} places", rows, targets)
