"""Three drives of 450 m through the daemon, beside an RTK receiver, judged by it and by the truth."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.config import FIRST_NETWORK, Config
from edge.descriptor.network import Network
from edge.telemetry.shadow import ShadowPosition
from sim.journal import records_of
from sim.shadow.drives import ShadowDrive, read_drives
from sim.shadow.judging import GpsComparison, compared
from sim.trial.draft import home_at_night
from sim.trial.run import TrialDrive
from sim.trial.simulation import Simulation
from sim.trial.views import RoadLibrary
from sim.vehicle.gps import GpsReport
from sim.vehicle.position_inputs import east_north_m
from sim.vehicle.pty_link import open_pty

LENGTH_M, WORLD = 450.0, 32
RTK = GpsReport(fix_type=mavlink.GPS_FIX_TYPE_RTK_FIXED, accuracy_m=0.05)


class BesideGps(TrialDrive):
    """Out by day and home at night, with GPS all the way."""

    def config(self, connection: str, map_path: Path) -> Config:
        made = super().config(connection, map_path)
        return msgspec.structs.replace(made, telemetry=msgspec.structs.replace(made.telemetry, emit="report"))


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RoadLibrary]:
    with closing(RoadLibrary(Network.load(Path(FIRST_NETWORK)), tmp_path_factory.mktemp("views"), 2)) as found:
        yield found


def driven(seed: int, library: RoadLibrary, folder: Path) -> tuple[ShadowDrive, ShadowDrive]:
    """What the journal says by GPS, and the same by the truth."""
    draft = home_at_night(seed, LENGTH_M, WORLD)
    draft.gps_until_m, draft.gps_at = math.inf, lambda time_s: RTK
    folder.mkdir()
    drive = BesideGps(draft, seed, folder, library)
    (folder / "map").mkdir()
    with closing(open_pty()) as link:
        simulation = drive.simulation(link)
        simulation.show(drive.network)
        drive.run_daemon(simulation, drive.config(f"serial:{link.device}:921600", folder / "map"))
    (by_gps,) = read_drives([drive.journal])
    off_m = np.array([true_off_m(one, simulation) for one in records_of(drive.journal, ShadowPosition)])
    return by_gps, replace(by_gps, off_m=off_m, gps_m=0.001 + 0 * by_gps.gps_m, late_m=0 * by_gps.late_m)


def true_off_m(one: ShadowPosition, simulation: Simulation) -> tuple[float, float]:
    """Ahead of where the vehicle was, and to the left."""
    if one.lat_deg is None or one.lon_deg is None:
        return math.nan, math.nan
    rows = np.array(simulation.rows)
    at_s = simulation.time_s(one.stamp_ns / 1e9)
    true_m = np.array([np.interp(at_s, rows[:, 0], rows[:, column]) for column in (3, 4)])
    east_m, north_m = np.array(east_north_m(one.lat_deg, one.lon_deg)) - true_m
    sin, cos = math.sin(math.radians(one.heading_deg or 0)), math.cos(math.radians(one.heading_deg or 0))
    return east_m * sin + north_m * cos, north_m * sin - east_m * cos


def all_of(drives: list[ShadowDrive]) -> GpsComparison:
    return compared(drives, [np.ones(len(one.gps_m), bool) for one in drives])


@pytest.mark.long
def test_sigmas_are_judged_as_the_truth_has_them(library: RoadLibrary, tmp_path: Path) -> None:
    by_gps, by_truth = (
        list(one) for one in zip(*(driven(n, library, tmp_path / f"{n}") for n in (1, 2, 3)), strict=True)
    )
    assert len(all_of(by_gps).gps_m) > 90, "a position nearly each second of the ways home"
    for axis in range(2):
        found, true = all_of(by_gps).factor(axis), all_of(by_truth).factor(axis)
        assert found is not None and true is not None
        assert found.best == pytest.approx(true.best, rel=0.25)
        for times, is_too_small in ((1.0, False), (2.0, True)):
            scaled = [replace(one, sigma_m=one.sigma_m * true.best / times) for one in by_gps]
            again = all_of(scaled).factor(axis)
            assert again is not None and again.is_too_small == is_too_small, (axis, times, again)
