"""Drives recorded as feeds, as fast as they render; positions are the simulator's truth."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Callable, Iterable
from contextlib import closing
from functools import partial
from pathlib import Path

import msgspec
import numpy as np
from tqdm import tqdm

import edge
from edge.config import SamplingConfig
from edge.feed import FeedHeader, FeedRow
from edge.feed.writer import FeedWriter
from sim import ORIGIN_ALT_M
from sim.world.camera import open_renderer, picture
from sim.world.drive import WorldDrive
from sim.world.scenario import Scenario

SPACING_M = SamplingConfig().spacing_m
TRUE_SIGMA_M = 0.1
"""Accuracy of positions that are the simulator's truth."""


def times_by_distance(drive: WorldDrive, spacing_m: float) -> list[float]:
    """Times at which the vehicle has covered each multiple of `spacing_m`."""
    return [drive.time_at_s(float(at_m)) for at_m in np.arange(0.0, drive.route.length_m, spacing_m)]


def times_by_rate(drive: WorldDrive, fps: float) -> list[float]:
    """Times of a steady frame rate over the whole drive."""
    return [float(time_s) for time_s in np.arange(0.0, drive.duration_s, 1 / fps)]


def record_drive(
    scenario: Scenario,
    path: Path,
    *,
    spacing_m: float = SPACING_M,
    fps: float | None = None,
    progress: Callable[[list[float]], Iterable[float]] = iter,
) -> int:
    """Render the drive of a scenario and write it as a feed; returns the number of frames.

    A frame every `spacing_m`, or `fps` frames a second. heading_deg is the vehicle's, also for a rear camera. The
    column `route_m` is the arc length along the route, which drives in both directions share. progress: passes the
    times on, one a frame, and may show how far they are. What was interrupted goes on. Raises FeedError, also where
    there is a feed already.
    """
    drive = scenario.drive()
    times_s = times_by_rate(drive, fps) if fps else times_by_distance(drive, spacing_m)
    header = FeedHeader(
        name=path.name,
        view=scenario.view,
        width=scenario.width,
        height=scenario.height,
        source=f"simulated, seed {scenario.seed}, {scenario.light}, {scenario.direction}, drive {scenario.drive_seed}",
        notes=f"route_m: meters along the route of {scenario.length_m:g} m; heading_deg: of the vehicle",
        time_sigma_s=0.0,
        odometer=True,
        fov_deg=scenario.fov_deg,
    )
    # The feed first: a folder that cannot be written to is known before the world is built.
    stamps_ns = [(scenario.epoch_ns or 0) + round(time_s * 1e9) for time_s in times_s]
    with (
        FeedWriter(path, header, extra_columns=("route_m",), begins=stamps_ns) as writer,
        closing(open_renderer(scenario, drive)) as renderer,
    ):
        for time_s in progress(times_s[writer.count :]):
            row = row_of(drive, time_s, scenario.epoch_ns or 0)
            writer.write(picture(renderer, scenario, drive, time_s), row)
    return len(times_s)


def recorded(scenario: Scenario, folder: Path, spacing_m: float = SPACING_M, name: str = "drive") -> Path:
    """The feed of a scenario, recorded once, in `folder` under a name with a hash of all that decides its pictures.

    It gets that name when it is complete, so that an interrupted rendering is not used.
    """
    decides = msgspec.json.encode([scenario, spacing_m, edge.__version__])
    path = folder / f"{name}-{hashlib.sha256(decides).hexdigest()[:12]}"
    if not path.is_dir():
        part = path.with_suffix(".part")
        shutil.rmtree(part, ignore_errors=True)
        bar = partial(tqdm, unit="frame", desc=part.name, disable=None)
        record_drive(scenario, part, spacing_m=spacing_m, progress=bar)
        part.rename(path)
    return path


def row_of(drive: WorldDrive, time_s: float, epoch_ns: int = 0) -> FeedRow:
    """What a recording says of a moment of a drive."""
    pose = drive.pose(time_s)
    at = *pose.geodetic(), ORIGIN_ALT_M, pose.heading_deg, pose.speed_mps, pose.distance_m
    stamp_ns, extra = epoch_ns + round(time_s * 1e9), {"route_m": f"{drive.route_m(time_s):.3f}"}
    return FeedRow("", stamp_ns, *at, position_sigma_m=TRUE_SIGMA_M, position_source="survey", extra=extra)
