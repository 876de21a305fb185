"""Positions against odometer and heading: honest GPS is consistent, one that is spoofed is not, and stays wrong."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.__main__ import main
from edge.geodesy import east_north, moved
from edge.reference_map.gps_motion import crept_m2, disagreements, moved_as_driven
from edge.reference_map.place_records import PLACE
from tests.localization.events_of import Road
from tests.localization.route_course import Stretch
from tests.tlog import messages_of

STEP_M, PLACES, FROM = 2.0, 600, 150
SIGMA_M = 1.4
"""As GPS of the trial: wandering over some 60 m."""
Drive = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]


def drive(
    seed: int,
    drift_mps: float = 0.0,
    side: str = "left",
    speed_mps: float = 5.0,
    *,
    scale: float = 1.03,
    bend: float = 1.0,
) -> Drive:
    """Positions (N, 2), odometer (N,) and heading (N,) of a winding drive, on which GPS drifts by up to 200 m.

    The compass is 3 degrees off, and 2 more or less as the vehicle turns.
    """
    rng = np.random.default_rng(seed)
    smooth = np.convolve(rng.normal(size=PLACES + 60), np.ones(60) / 60, "valid")[:PLACES]
    heading = np.cumsum(0.09 * bend * smooth)
    middle = (heading[1:] + heading[:-1]) / 2
    truth_m = np.vstack([[0, 0], np.cumsum(STEP_M * np.column_stack([np.sin(middle), np.cos(middle)]), axis=0)])
    wander_m = np.zeros((PLACES, 2))
    for row in range(1, PLACES):
        wander_m[row] = 0.97 * wander_m[row - 1] + SIGMA_M * np.sqrt(1 - 0.97**2) * rng.normal(size=2)
    off_m = np.clip((np.arange(PLACES) - FROM) * STEP_M / speed_mps * drift_mps, 0.0, 200.0)
    toward = heading + {"left": -np.pi / 2, "right": np.pi / 2, "ahead": 0.0}[side]
    away_m = np.diff(off_m, prepend=0.0)[:, None] * np.column_stack([np.sin(toward), np.cos(toward)])
    heading_deg = np.degrees(heading) + 3.0 + 2.0 * np.sin(heading)
    return truth_m + wander_m + np.cumsum(away_m, axis=0), np.arange(0.0, PLACES) * STEP_M * scale, heading_deg


def rejected(
    points_m: NDArray[np.float64], driven_m: NDArray[np.float64], heading_deg: NDArray[np.float64]
) -> list[int]:
    """The rows that disagree."""
    found = disagreements(points_m, np.full(len(points_m), SIGMA_M), driven_m, heading_deg)
    return [row for row, one in enumerate(found) if one is not None]


def places(points_m: NDArray[np.float64], driven_m: NDArray[np.float64], heading_deg: NDArray[np.float64]) -> Any:
    """The same as records of a map, near the equator."""
    records = np.zeros(len(points_m), PLACE)
    records["lat_deg"], records["lon_deg"] = np.transpose([moved(0.0, 10.0, *point_m) for point_m in points_m])
    records["route_m"], records["heading_deg"], records["position_sigma_m"] = driven_m, heading_deg, SIGMA_M
    return records


def test_a_drive_moved_as_its_vehicle_if_all_of_it_did() -> None:
    for seed in range(20):
        assert moved_as_driven(places(*drive(seed, bend=seed % 3)))
        for side in ("left", "right", "ahead"):
            for drift_mps in (1.0, 5.0, 100.0):
                assert not moved_as_driven(places(*drive(seed, drift_mps, side, bend=seed % 3)))


@pytest.mark.parametrize("name", ["lat_deg", "lon_deg", "heading_deg", "route_m"])
def test_where_something_is_not_known_a_drive_is_not_known_to_have_moved_as_its_vehicle(name: str) -> None:
    records = places(*drive(1))
    records[name][300] = np.nan
    assert not moved_as_driven(records)


def test_a_step_too_long_to_know_its_direction_leaves_a_drive_unchecked() -> None:
    """Over 24 m without a place, all that follows may lie aside."""
    records = places(*drive(1))
    assert not moved_as_driven(np.delete(records, slice(300, 311)))
    assert moved_as_driven(np.delete(records, slice(300, 308)))


@pytest.mark.parametrize("scale", [0.85, 1.0, 1.03])
def test_honest_gps_agrees(scale: float) -> None:
    """On straight and winding roads, also where the wheels count 15 % too little."""
    for seed in range(40):
        assert not rejected(*drive(seed, scale=scale, bend=seed % 3))


def test_a_burst_of_multipath_at_the_beginning_rejects_little_of_what_follows() -> None:
    """10 m in any direction, while scale and rotation are being learned."""
    for seed in range(80):
        points_m, driven_m, heading_deg = drive(seed, bend=seed % 3)
        rng = np.random.default_rng(seed)
        angle, first, places = rng.uniform(0.0, 2 * np.pi), rng.integers(5, 60), rng.integers(10, 45)
        points_m[first : first + places] += 10.0 * np.array([np.sin(angle), np.cos(angle)])
        lost = [row for row in rejected(points_m, driven_m, heading_deg) if row >= first + places]
        assert STEP_M * len(lost) < 60.0


@pytest.mark.parametrize("side", ["left", "right", "ahead"])
@pytest.mark.parametrize("drift_mps", [1.0, 2.0, 5.0, 10.0, 20.0])
def test_a_drag_is_found_and_what_follows_stays_rejected(drift_mps: float, side: str) -> None:
    for seed in range(100, 110):
        rows = rejected(*drive(seed, drift_mps, side))
        assert FROM < rows[0] < FROM + 60, "within 120 m"
        last = rows[0] + 200
        assert len([row for row in rows if row < last]) > 0.95 * (last - rows[0]), "an offset that stays is no excuse"


def crept_m(points_m: NDArray[np.float64], driven_m: NDArray[np.float64], heading_deg: NDArray[np.float64]) -> float:
    """By how much the last position may be off against the first."""
    return math.sqrt(crept_m2(points_m, np.full(len(points_m), 2**0.5 * SIGMA_M), driven_m, heading_deg)[-1])


@pytest.mark.parametrize("side", ["left", "ahead"])
def test_what_creeps_by_less_than_counts_as_wrong_is_measured(side: str) -> None:
    """By 4 % of the way. Honest GPS wanders by its own standard deviation, on a straight road."""
    honest_m, spoofed_m = (
        np.median([crept_m(*drive(seed, drift_mps, side, bend=0.0)) for seed in range(10)]) for drift_mps in (0.0, 0.2)
    )
    assert honest_m < 1.0
    assert spoofed_m > 5.0
    points_m, *driven = drive(1, bend=0.0)  # what is elsewhere is wrong, not uncertain: a hypothesis finds it
    assert crept_m(points_m + np.where(np.arange(PLACES) < 300, 0.0, 300.0)[:, None], *driven) < 1.0


def test_map_info_says_by_how_much_gps_crept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, crept in (("honest", (0.0, 1.0, 0.0, 0.0)), ("crept", (300.0, 600.0, 12.0, 0.0))):
        Road(tmp_path / name, Stretch(0.0, 1000.0, has_odometer=True, crept=crept))
    assert main(["map", "info", str(tmp_path / "honest" / "map")]) == 0
    assert "otherwise than the vehicle" not in capsys.readouterr().out
    assert main(["map", "info", str(tmp_path / "crept" / "map")]) == 0
    assert "its GPS moved by some 10 m otherwise than the vehicle" in capsys.readouterr().out


def test_without_a_heading_lengths_are_compared() -> None:
    points_m, driven_m, heading_deg = drive(1)
    unknown = np.full_like(heading_deg, np.nan)
    assert not rejected(points_m, driven_m, unknown)
    assert rejected(points_m + np.where(np.arange(PLACES) < 300, 0.0, 20.0)[:, None], driven_m, unknown)[0] == 300
    assert not rejected(points_m * 3, np.full_like(driven_m, np.nan), unknown), "nothing is known of the motion"


def test_a_jump_aside_in_a_gentle_gap_is_found() -> None:
    """36 m without a place, as while the autopilot is silent for 4 s: where the road hardly turns, its way is known."""
    kept = np.r_[0:200, 218:PLACES]
    for seed in range(10):
        points_m, driven_m, heading_deg = (values[kept] for values in drive(seed, bend=0.5))
        heading_rad = np.radians(heading_deg[200])
        sideways_m = 20.0 * np.array([np.cos(heading_rad), -np.sin(heading_rad)])
        jumped_m = points_m + np.where(np.arange(len(kept)) < 200, 0.0, 1.0)[:, None] * sideways_m
        assert not rejected(points_m, driven_m, heading_deg)
        assert rejected(jumped_m, driven_m, heading_deg)[0] == 200


def test_a_gap_in_the_places_is_no_jump() -> None:
    points_m, driven_m, heading_deg = drive(2, bend=3.0)
    kept = np.r_[0:200, 300:PLACES]
    assert not rejected(points_m[kept], driven_m[kept], heading_deg[kept])


@pytest.mark.parametrize(
    ("name", "least", "most"),
    [
        ("ardupilot_tmh921", 0, 0),
        ("px4_take_me_home_wrong_item_w924", 0, 0),
        ("ardupilot_spoofL911", 100, 400),
        ("ardupilot_spoofA912", 50, 200),
        ("px4_gps_dragged_1mps_left_w921", 200, 400),
    ],
)
def test_recorded_drives(shared: Path, name: str, least: int, most: int) -> None:
    """Real autopilots with GPS, honest or spoofed by 1 m/s; a place every 2 m while it has a fix."""
    folder = shared / "flights_b06f79e" / name
    if not folder.is_dir():
        pytest.skip(f"needs the recorded drive {folder}")
    positions, wheels, has_fix = [], [], False
    for now_ns, messages in messages_of(folder / "telem2.tlog.gz"):
        time_s = now_ns / 1e9
        for message in messages:
            kind = message.get_type()
            if kind == "GPS_RAW_INT":
                has_fix = message.fix_type >= 3
            elif kind == "WHEEL_DISTANCE":
                wheels.append((time_s, sum(message.distance[:2]) / 2))
            elif kind == "GLOBAL_POSITION_INT" and message.lat and has_fix:
                speed_mps = float(np.hypot(message.vx, message.vy)) / 100
                positions.append((time_s, message.lat / 1e7, message.lon / 1e7, message.hdg / 100, speed_mps))
    times_s, lat_deg, lon_deg, heading_deg, speed_mps = np.array(positions).T
    driven_m = np.r_[0.0, np.cumsum((speed_mps[1:] + speed_mps[:-1]) / 2 * np.diff(times_s))]
    if wheels:
        driven_m = np.interp(times_s, *np.array(wheels).T)
    rows = np.unique(np.searchsorted(driven_m, np.arange(driven_m[0], driven_m[-1], STEP_M)))
    assert len(rows) > 180
    found = rejected(east_north(lat_deg[rows], lon_deg[rows]), driven_m[rows], heading_deg[rows])
    assert least <= len(found) <= most
