"""Drives recorded as feeds, as fast as they render; positions are the simulator's truth."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from edge.feed import FeedHeader, FeedWriter
from sim import ORIGIN_ALT_M
from sim.world.camera import open_renderer
from sim.world.drive import Drive
from sim.world.scenario import Scenario


def times_by_distance(drive: Drive, spacing_m: float) -> list[float]:
    """Times at which the vehicle has covered each multiple of `spacing_m`."""
    return [drive.time_at_s(float(at_m)) for at_m in np.arange(0.0, drive.route.length_m, spacing_m)]


def times_by_rate(drive: Drive, fps: float) -> list[float]:
    """Times of a steady frame rate over the whole drive."""
    return [float(time_s) for time_s in np.arange(0.0, drive.duration_s, 1 / fps)]


def write_feed(scenario: Scenario, drive: Drive, path: Path, times_s: Iterable[float]) -> int:
    """Render the drive at some times and write a feed; returns the number of frames.

    heading_deg is the vehicle's, also for a rear camera. The column `route_m` is the arc length along the route,
    which drives in both directions share. Raises FeedError, also for a feed that is there already.
    """
    header = FeedHeader(
        name=path.name,
        view=scenario.view,
        width=scenario.width,
        height=scenario.height,
        source=f"simulated, seed {scenario.seed}, {scenario.light}, {scenario.direction}, drive {scenario.drive_seed}",
        notes=f"route_m: metres along the route of {scenario.length_m:g} m; heading_deg: of the vehicle",
    )
    count = 0
    # The feed first: a folder that cannot be written to is known before the world is built.
    with FeedWriter(path, header, extra_columns=("route_m",)) as writer:
        renderer = open_renderer(scenario, drive)
        try:
            for time_s in times_s:
                image = renderer.render(drive.pose(time_s, scenario.camera_ahead_m), time_s)
                _write_frame(writer, drive, image, time_s, scenario.epoch_ns or 0)
                count += 1
        finally:
            renderer.close()
    return count


def _write_frame(writer: FeedWriter, drive: Drive, image: np.ndarray, time_s: float, epoch_ns: int) -> None:
    pose = drive.pose(time_s)
    lat_deg, lon_deg = pose.geodetic()
    writer.write(
        image,
        epoch_ns + round(time_s * 1e9),
        lat_deg=lat_deg,
        lon_deg=lon_deg,
        alt_m=ORIGIN_ALT_M,
        heading_deg=pose.heading_deg,
        speed_mps=pose.speed_mps,
        distance_m=pose.distance_m,
        extra={"route_m": f"{drive.route_m(time_s):.3f}"},
    )
