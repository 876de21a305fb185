"""Keypoints of the map that is made while driving: searched once the drive has gone on, and kept through anything."""

from __future__ import annotations

import shutil
import sqlite3
import threading
from contextlib import closing
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.config import SamplingConfig
from edge.feed import FeedImages, read_feed
from edge.geodesy import VehiclePosition
from edge.keypoints import Keypoints
from edge.keypoints.mount import unknown
from edge.keypoints.network import KeypointNetwork
from edge.reference_map import MapSet, ReferenceMap, open_map
from edge.reference_map.keypoint_file import KEYPOINT, MOST_PIXELS, KeypointsKey
from edge_plugins.mapping import MappingConfig
from edge_plugins.mapping.builder import MapBuilder, Place
from edge_plugins.mapping.drive_store import DriveStore
from edge_plugins.mapping.keypoint_rows import MOST_OF_PLACE, keypoints_key
from edge_plugins.mapping.live_keypoints import MOST_PICTURES
from edge_plugins.mapping.live_map import LiveMap
from edge_plugins.mapping.place_log import OpenLog, PlaceLog, create_log, logs_in
from edge_plugins.mapping.place_log_records import LogHeader
from tests.plugins.mapping.test_live_map import MODEL, REGIONS, START_S, raw_of
from tests.plugins.mapping.test_place_log import damage

FOV_DEG, PLACES = 80.0, 30
FEED = read_feed(Path(__file__).parents[2] / "golden/recordings/out_first")
IMAGES = FeedImages(FEED)
BEHIND = 5
"""Places of 10 m, after which the points of a place are known."""


def live(folder: Path, later_s: float = 0.0, *, fov_deg: float | None = FOV_DEG, focal_sigma: float = 0.0) -> LiveMap:
    config, header = MappingConfig(folder=str(folder), min_free_mb=0.0), LogHeader(MODEL, REGIONS, SamplingConfig())
    return LiveMap(
        config, DriveStore(config, header, "rear", lambda: START_S + later_s, fov_deg=fov_deg, focal_sigma=focal_sigma)
    )


def drive(mapped: LiveMap, rows: range, *, waits: bool = True) -> None:
    """The recorded road; waits: for the keypoints, as a vehicle that takes longer from place to place."""
    for number in rows:
        row = FEED.rows[number]
        assert row.lat_deg is not None and row.lon_deg is not None and row.heading_deg is not None
        at = VehiclePosition(0, row.lat_deg, row.lon_deg, 20.0, row.heading_deg, 5.0, sigma_m=1.0, source="rtk_fixed")
        mapped.add(raw_of(number), IMAGES.read(number), at, row.distance_m)
        if waits:
            mapped.store.keypoints.wait()


def known(records: NDArray[np.void]) -> int:
    """How many points of a place have a distance."""
    return int(np.isfinite(records["inverse"]).sum())


def known_of(reference: ReferenceMap) -> list[int]:
    assert reference.keypoints is not None
    return [known(reference.keypoints[row]) for row in range(reference.header.places)]


def finished(folder: Path) -> ReferenceMap:
    """The map that the next day's start makes of the drive."""
    live(folder, later_s=86_400.0).store.close()
    (path,) = (one for one in folder.iterdir() if one.is_dir())
    return open_map(path, every_file=True)


def test_a_place_has_points_once_the_drive_has_gone_on_by_ten_meters(tmp_path: Path) -> None:
    mapped = live(tmp_path, focal_sigma=0.2)
    drive(mapped, range(PLACES))
    whole = MapSet.of(mapped.store.whole())
    points = [known(whole.keypoints_of(row)) for row in range(PLACES)]
    assert min(points[:-BEHIND]) >= 30 and points[-BEHIND:] == [0] * BEHIND, points
    assert whole.headers[0].keypoints_key == keypoints_key(
        FEED.header.height, FEED.header.width, FOV_DEG, focal_sigma=0.2
    )
    mapped.store.close()
    assert min(known_of(finished(tmp_path))) >= 20, "the last places have those of what lies before them"


def test_the_finished_map_has_the_keypoints_that_a_map_of_the_recording_has(tmp_path: Path) -> None:
    mapped = live(tmp_path / "live")
    drive(mapped, range(PLACES))
    mapped.store.close()
    extract, key_of = KeypointNetwork().extract, partial(keypoints_key, fov_deg=FOV_DEG)
    with MapBuilder(tmp_path / "built", MODEL, REGIONS, SamplingConfig(), keypoints=key_of) as builder:
        builder.begin_segment("out_first", "rear", has_odometer=True)
        for number, row in enumerate(FEED.rows[:PLACES]):
            assert builder.keypoints is not None and row.heading_deg is not None and row.distance_m is not None
            builder.keypoints.add(extract(IMAGES.read(number)))
            builder.add(raw_of(number), Place(number, heading_deg=row.heading_deg, route_m=row.distance_m))
        builder.finish()
    found, built = (one.keypoints for one in (finished(tmp_path / "live"), open_map(tmp_path / "built")))
    assert found is not None and built is not None
    np.testing.assert_array_equal(found["descriptor"], built["descriptor"])
    both = np.isfinite(found["inverse"]) & np.isfinite(built["inverse"])
    assert both.sum() > 0.9 * np.isfinite(built["inverse"]).sum()
    off = np.abs(found["inverse"] - built["inverse"])[both] / built["sigma"][both]
    assert np.percentile(off, 90) < 1.0, "the mount that each row begins with differs"


def test_what_was_known_before_a_kill_is_known_after_it_and_the_drive_goes_on(tmp_path: Path) -> None:
    mapped = live(tmp_path / "maps")
    drive(mapped, range(20))
    while mapped.store.waiting:
        pass
    shutil.copytree(tmp_path / "maps", tmp_path / "killed")
    before = known_of(mapped.store.whole())
    mapped.store.close()
    again = live(tmp_path / "killed", later_s=30.0)
    assert known_of(again.store.whole()) == before and before[15:] == [0] * BEHIND
    drive(again, range(20, PLACES))
    points = known_of(again.store.whole())
    assert min(points[:15]) >= 30 and min(points[20 : PLACES - BEHIND]) >= 30 and len(points) == PLACES
    again.store.close()
    assert known_of(finished(tmp_path / "killed"))[15:20] == [0] * BEHIND, "those of the newest places are lost"


def test_points_that_are_damaged_cost_their_place_its_keypoints_and_no_place(tmp_path: Path) -> None:
    mapped = live(tmp_path)
    drive(mapped, range(PLACES))
    mapped.store.close()
    damage(logs_in(tmp_path)[0], "points", 3)
    found = known_of(finished(tmp_path))
    assert [row for row, points in enumerate(found) if not points] == [3]


def test_a_place_that_is_lost_with_its_points_behind_it_begins_a_new_drive(tmp_path: Path) -> None:
    mapped = live(tmp_path)
    drive(mapped, range(PLACES))
    mapped.store.close()
    (file,) = logs_in(tmp_path)
    damage(file, "places", 20)
    log = OpenLog(file)
    assert [first for first, _ in log.drives] == [0, 20]
    log.close()


def test_the_points_of_a_place_that_a_full_disk_has_not_taken_at_the_end_are_not_written(tmp_path: Path) -> None:
    header = LogHeader(MODEL, REGIONS, SamplingConfig(), keypoints=keypoints_key(120, 160, FOV_DEG))
    log = PlaceLog(create_log(tmp_path / "log", header))
    log.begin_drive("rear")
    points = np.zeros(MOST_OF_PLACE, KEYPOINT)
    for row in range(3):
        assert log.add(raw_of(row), Place(row), START_S)
        log.add_points(row, points, unknown(1.0))
    while log.waiting:
        pass
    log.min_free_bytes = np.inf
    assert log.add(raw_of(3), Place(3), START_S)
    log.add_points(3, points, unknown(1.0))
    log.close(timeout_s=30)
    left = OpenLog(tmp_path / "log")
    assert len(left.rows) == 3 and all(left.points(row) for row in range(3))
    left.close()
    with closing(sqlite3.connect(tmp_path / "log")) as db:
        assert db.execute("SELECT count(*) FROM points").fetchone() == (3,)


def test_a_drive_goes_on_only_with_the_keypoints_that_it_has(tmp_path: Path) -> None:
    for number, fov_deg in enumerate((FOV_DEG, None, 90.0)):
        mapped = live(tmp_path, later_s=30.0 * number, fov_deg=fov_deg)
        assert mapped.status.places == 0
        drive(mapped, range(22))
        mapped.store.close()
    made = [open_map(path) for path in sorted(tmp_path.iterdir()) if path.is_dir()]
    keys = [one.header.keypoints_key for one in made]
    assert [None if key is None else key.fov_deg for key in keys] == [FOV_DEG, None]
    assert made[1].keypoints is None


def test_where_the_computer_is_too_slow_the_map_has_all_places_and_says_once_that_some_lack_keypoints(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    goes_on, extract = threading.Event(), KeypointNetwork.extract

    def waiting(self: KeypointNetwork, image: NDArray[np.uint8], most: int) -> Keypoints:
        goes_on.wait(30)
        return extract(self, image, most)

    monkeypatch.setattr(KeypointNetwork, "extract", waiting)
    mapped = live(tmp_path)
    drive(mapped, range(12), waits=False)
    assert mapped.status.places == 12
    goes_on.set()
    mapped.store.close()
    assert [one.message for one in caplog.records if "too slow" in one.message] == [
        "keypoints of the map of this drive: the computer is too slow for those of all places"
    ]
    log = OpenLog(logs_in(tmp_path)[0])
    assert len(log.rows) == 12 and sum(log.points(row) is not None for row in range(12)) == MOST_PICTURES
    log.close()


def test_a_picture_larger_than_positions_in_a_map_reach_is_counted_as_a_smaller_one() -> None:
    key = keypoints_key(2160, 3840, FOV_DEG)
    assert key == KeypointsKey(key.network, key.sha256, MOST_OF_PLACE, MOST_PIXELS, 1152, FOV_DEG)
