"""An outage of GPS on a drive that is mapped: where its places are put once GPS is back, and what is never bridged."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from edge.geodesy import POSITION_SOURCES, VehiclePosition, east_north_of, moved
from edge_plugins.mapping.live_map import LiveMap
from tests.plugins.mapping.test_live_map import GPS, IMAGE, live, raw_of
from tests.reference_map.test_gps_motion import FROM, SIGMA_M, Drive
from tests.reference_map.test_gps_motion import drive as gps_drive

ORIGIN = GPS.lat_deg, GPS.lon_deg


def at(points: Drive, row: int) -> VehiclePosition:
    lat_deg, lon_deg = moved(*ORIGIN, *points[0][row].tolist())
    return replace(GPS, lat_deg=lat_deg, lon_deg=lon_deg, heading_deg=float(points[2][row]) % 360, sigma_m=SIGMA_M)


def add(mapped: LiveMap, points: Drive, rows: range, fault: str = "", **changes: Any) -> None:
    """Map these rows of a drive; changes: of the autopilot's position, None without one."""
    for row in rows:
        position = None if changes.get("source") == "none" else replace(at(points, row), **changes)
        mapped.add(raw_of(row), IMAGE, position, float(points[1][row]), fault)
        while mapped.store.waiting > 8:
            os.sched_yield()


def segments(mapped: LiveMap) -> list[tuple[int, int]]:
    return [(one.start, one.end) for one in mapped.store.whole().header.segments]


@pytest.mark.parametrize("places", [10, 50, 150])
def test_places_of_an_outage_are_where_they_were_within_what_they_say(tmp_path: Path, places: int) -> None:
    """Wheels and compass are wrong by 3 % and 3 degrees, and the road winds; GPS would have been wrong as well.

    Of the autopilot's own position meanwhile, which is on the equator here, nothing is used.
    """
    in_sigmas = []
    for seed in range(12):
        points, mapped = gps_drive(seed, bend=seed % 3), live(tmp_path / str(seed))
        add(mapped, points, range(FROM))
        adrift: dict[str, Any] = {
            "source": "dead_reckoning",
            "sigma_m": None,
            "lat_deg": 0.0,
        }  # nothing is used of that position
        add(mapped, points, range(FROM, FROM + places), **adrift)
        assert (mapped.status.state, mapped.status.why, mapped.status.places) == ("waiting", "no GPS", FROM)
        add(mapped, points, range(FROM + places, FROM + places + 20))
        assert segments(mapped) == [(0, FROM + places + 20)]
        found = mapped.store.whole().places[FROM : FROM + places]
        off_m = [
            np.hypot(*(np.array(east_north_of(lat, lon, ORIGIN)) - point))
            for lat, lon, point in zip(found["lat_deg"], found["lon_deg"], points[0][FROM:], strict=False)
        ]
        assert found["position_sigma_m"].max() <= 5.0
        in_sigmas.extend(off_m / np.hypot(found["position_sigma_m"], SIGMA_M))
        mapped.store.close()
    assert np.sqrt(np.mean(np.square(in_sigmas))) < 1.0
    assert max(in_sigmas) < 3.0


def test_gps_that_moves_otherwise_for_a_while_is_bridged(tmp_path: Path) -> None:
    """As between high buildings: those positions enter no map, and the drive goes on."""
    points, mapped = gps_drive(3), live(tmp_path)
    add(mapped, points, range(FROM))
    east_m, north_m = points[0][FROM : FROM + 20].T
    burst = points[0].copy()
    burst[FROM : FROM + 20] = np.column_stack([east_m + 15.0, north_m])
    add(mapped, (burst, *points[1:]), range(FROM, FROM + 40))
    assert segments(mapped) == [(0, FROM + 40)]
    found = mapped.store.whole().places[FROM : FROM + 20]
    off_m = [east_north_of(lat, lon, ORIGIN)[0] for lat, lon in zip(found["lat_deg"], found["lon_deg"], strict=True)]
    assert np.abs(off_m - east_m).max() < 5.0
    assert {POSITION_SOURCES[number] for number in found["position_source"]} == {"dead_reckoning"}
    mapped.store.close()


def test_places_between_bursts_of_multipath_are_where_they_were_within_what_they_say(tmp_path: Path) -> None:
    """GPS is 10 m off for 24 to 120 m, three times a drive; after 100 m it could as well be reckoning that has erred.

    Such a burst may neither spoil what is learned of wheels and compass, nor have what follows rejected.
    """
    in_sigmas: list[float] = []
    for seed in range(8):
        points, rng, mapped = gps_drive(seed, bend=seed % 3), np.random.default_rng(seed), live(tmp_path / str(seed))
        burst = points[0].copy()
        for first, places in zip(
            np.array([40, 160, 280]) + rng.integers(0, 60, 3), rng.integers(12, 60, 3), strict=True
        ):
            toward = rng.uniform(0.0, 2 * np.pi)
            burst[first : first + places] += 10.0 * np.array([np.sin(toward), np.cos(toward)])
        add(mapped, (burst, *points[1:]), range(400))
        assert segments(mapped) == [(0, mapped.status.places)]
        assert mapped.status.places > 350
        found = mapped.store.whole().places
        for place in found:
            row = round(place["route_m"] / points[1][1])
            off_m = np.hypot(*(np.array(east_north_of(place["lat_deg"], place["lon_deg"], ORIGIN)) - points[0][row]))
            in_sigmas.append(off_m / np.hypot(place["position_sigma_m"], SIGMA_M))
        mapped.store.close()
    assert np.mean(np.array(in_sigmas) > 3.0) < 0.001
    assert np.sqrt(np.mean(np.square(in_sigmas))) < 1.0


def test_frames_without_any_position_count_as_places_without_a_frame(tmp_path: Path) -> None:
    points, mapped = gps_drive(3), live(tmp_path)
    add(mapped, points, range(FROM))
    add(mapped, points, range(FROM, FROM + 3), source="none")
    add(mapped, points, range(FROM + 3, FROM + 20))
    assert segments(mapped) == [(0, FROM + 20)]
    assert np.diff(mapped.store.whole().places["route_m"]).max() < 1.1 * points[1][1]
    mapped.store.close()


def test_places_without_a_frame_are_where_the_vehicle_went(tmp_path: Path) -> None:
    """A camera is silent for 60 m in a bend, whose chord is over 5 m away."""
    bend = np.radians(np.arange(180.0))
    points = 2.0 / np.radians(1.0) * 0.4 * np.column_stack([1 - np.cos(bend), np.sin(bend)])
    driven_m = np.arange(180.0) * 0.8
    mapped, gap = live(tmp_path), range(60, 135)
    for row in range(180):
        lat_deg, lon_deg = moved(*ORIGIN, *points[row].tolist())
        position = replace(GPS, lat_deg=lat_deg, lon_deg=lon_deg, heading_deg=float(row))
        mapped.go_on(position, float(driven_m[row]))
        if row not in gap:
            missed = len(gap) if row == gap.stop else 0
            mapped.add(raw_of(row), IMAGE, position, float(driven_m[row]), missed=missed)
    assert segments(mapped) == [(0, 180)]
    found = mapped.store.whole().places
    found_m = np.array(
        [east_north_of(lat, lon, ORIGIN) for lat, lon in zip(found["lat_deg"], found["lon_deg"], strict=True)]
    )
    assert np.hypot(*(found_m - points).T).max() < 0.5
    middle_m = (points[gap.start - 1] + points[gap.stop]) / 2
    assert np.hypot(*(points - middle_m).T).min() > 5.0
    mapped.store.close()


@pytest.mark.parametrize(
    ("places", "changes", "fault"),
    [
        (250, {"source": "dead_reckoning"}, ""),
        (50, {"source": "dead_reckoning", "heading_deg": None}, ""),
        (30, {"source": "place_fixes"}, ""),
        (30, {}, "GPS is wrong by the places"),
    ],
    ids=["too long", "no heading", "by places", "GPS faulty"],
)
def test_what_is_not_bridged(tmp_path: Path, places: int, changes: dict[str, Any], fault: str) -> None:
    points, mapped = gps_drive(3), live(tmp_path)
    add(mapped, points, range(FROM))
    add(mapped, points, range(FROM, FROM + places), fault, **{"sigma_m": None, **changes})
    add(mapped, points, range(FROM + places, FROM + places + 20))
    before, (first, end) = segments(mapped)
    assert (before, first) == ((0, FROM), FROM)
    assert end >= FROM + 19, "after 500 m, the first place may still be in doubt"
    mapped.store.close()


def test_an_odometer_that_was_silent_ends_an_outage(tmp_path: Path) -> None:
    points, mapped = gps_drive(3), live(tmp_path)
    add(mapped, points, range(FROM))
    add(mapped, points, range(FROM, FROM + 10), source="dead_reckoning", sigma_m=None)
    mapped.interrupt()
    add(mapped, points, range(FROM + 10, FROM + 30))
    found = mapped.store.whole().places
    gap = np.flatnonzero(np.isnan(found["heading_deg"]))
    assert segments(mapped) == [(0, len(found))], "the way was short and straight, by GPS"
    assert (gap[0], gap[-1]) == (FROM, len(found) - 21)
    assert "dead_reckoning" not in {POSITION_SOURCES[number] for number in found["position_source"]}
    mapped.store.close()
