"""Keypoints of a map: what is written is read again, with distances by all rows; what is damaged has one line."""

from __future__ import annotations

import json
import os
import re
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from edge.config import SamplingConfig
from edge.errors import MapError
from edge.keypoints import CameraModel, Keypoints
from edge.keypoints.pose import pose_to_keyframe as pose_by
from edge.reference_map import MapSet, ReferenceMap, open_map
from edge.reference_map.keypoint_file import KeypointsKey
from edge.reference_map.keypoint_records import keypoints_of, points_of, record_of
from edge.reference_map.store import HEADER, KEYPOINTS, ModelKey, RegionsKey, open_unverified
from edge_plugins.mapping.builder import MapBuilder, Place
from sim.maps.command import add_map
from sim.maps.tiles import split_map
from tests.keypoints.street import CAMERA, seen, street

KEY = KeypointsKey("test", "0" * 64, 60, CAMERA.width, CAMERA.height, CAMERA.fov_deg)
MODEL, REGIONS = ModelKey("test", "0" * 64, "fc6", 16), RegionsKey("left-right", 0.4)
PLACES = 200
WORLD_M = street(np.random.default_rng(4), 800)
WORLD_M[:, 2] = np.random.default_rng(3).uniform(0, 460, len(WORLD_M))  # along the 400 m of the drive


def keypoints_at(ahead_m: float) -> tuple[Keypoints, np.ndarray]:
    """What a camera sees so far along the street, and the distances of that."""
    directions, away_m = seen(WORLD_M, (0, ahead_m, 0, 0)), WORLD_M[:, 2] - ahead_m
    xy = directions * CAMERA.focal_px + CAMERA.middle
    shown = np.flatnonzero((away_m > 8) & (away_m < 60) & (np.abs(xy - CAMERA.middle) < CAMERA.middle).all(axis=1))[:60]
    descriptors = np.random.default_rng(5).normal(size=(len(WORLD_M), 64))
    descriptors *= 127 / np.linalg.norm(descriptors, axis=1, keepdims=True)
    kept = np.rint(descriptors[shown]).astype(np.int8)
    size = (CAMERA.height, CAMERA.width)
    return Keypoints(xy[shown].astype(np.float32), np.ones(len(shown), np.float32), kept, size), away_m[shown]


def build(
    path: Path, *, places: int = PLACES, view: Literal["front", "rear"] = "front", heading_deg: float = 30.0
) -> ReferenceMap:
    """A map of places 2 m apart, with keypoints."""
    raw = np.random.default_rng(0).random((places, 2, 16)).astype(np.float32)
    with MapBuilder(path, MODEL, REGIONS, SamplingConfig(), keypoints=lambda height, width: KEY) as builder:
        assert builder.keypoints is not None
        builder.begin_segment("drive", view)
        for row in range(places):
            along_m = 2.0 * row if view == "front" else 2.0 * (places - row)
            builder.add(raw[row], Place(row, heading_deg=30.0, route_m=2.0 * row))
            builder.keypoints.add(keypoints_at(along_m)[0])
        builder.finish()
    return open_map(path, every_file=True)


@pytest.mark.parametrize("view", ["front", "rear"])
def test_a_map_has_the_keypoints_of_its_pictures_and_how_far_away_they_are(
    tmp_path: Path, view: Literal["front", "rear"]
) -> None:
    made = build(tmp_path / "map", places=30, view=view)
    assert isinstance(made.keypoints, np.memmap)
    row = 12
    expected, away_m = keypoints_at(24.0 if view == "front" else 36.0)
    found, points = keypoints_of(made.keypoints[row], KEY), points_of(made.keypoints[row])
    assert np.array_equal(found.descriptors, expected.descriptors)
    assert found.xy == pytest.approx(expected.xy, abs=0.5 / 32)
    assert points.is_known.mean() > 0.8
    assert points.places[points.is_known, 2] == pytest.approx(1 / away_m[points.is_known], rel=0.05)


def test_a_place_takes_at_most_30_kilobytes_and_a_picture_of_less_leaves_the_rest_empty() -> None:
    assert record_of(keypoints_at(0)[0], KEY).nbytes * 300 / KEY.most < 30_000
    whole = keypoints_at(0)[0]
    few = replace(whole, xy=whole.xy[:5], scores=whole.scores[:5], descriptors=whole.descriptors[:5])
    assert len(keypoints_of(record_of(few, KEY), KEY)) == 5


def bytes_of(records: np.ndarray | None) -> bytes:
    assert records is not None
    return records.tobytes()


def test_a_damaged_file_and_one_of_another_size_have_a_line_that_names_it(tmp_path: Path) -> None:
    file = build(tmp_path / "map", places=20).path / KEYPOINTS
    data = bytearray(file.read_bytes())
    data[1000] ^= 1
    file.write_bytes(data)
    damaged = r"keypoints.bin: damaged \(checksum mismatch\); build or copy the map again$"
    with pytest.raises(MapError, match=damaged):
        open_map(file.parent)
    schedule = MapSet.of(open_unverified(file.parent)).checksum_schedule()
    (why,) = next(filter(None, (schedule.step(1 << 20) for _ in range(20)))).values()
    assert re.search(damaged, why)
    file.write_bytes(data[:-1])
    with pytest.raises(MapError, match=r"keypoints.bin: \d+ bytes where the header says \d+; build or copy it again$"):
        open_unverified(file.parent)


def test_keypoints_that_are_cut_off_while_in_use_are_read_no_more(tmp_path: Path) -> None:
    maps = MapSet.of(build(tmp_path / "map", places=20))
    query = np.ones((1, 2, 16), np.float32)
    assert maps.maps[0].keypoints is not None
    assert maps.costs(query, [(0, 20)]).shape[2] == 20
    os.truncate(tmp_path / "map" / KEYPOINTS, 0)
    with pytest.raises(MapError, match=r"map/keypoints.bin: cut off while it is in use; copy the map again"):
        maps.costs(query, [(0, 20)])
    assert list(maps.cut) == [tmp_path / "map"]


def test_a_camera_with_another_field_of_view_can_look_at_a_map(tmp_path: Path) -> None:
    made, wide = build(tmp_path / "map", places=30), CameraModel(400, 260, 100.0)
    assert made.keypoints is not None
    shown, _ = keypoints_at(24.0)
    xy = (CAMERA.directions(shown.xy) * wide.focal_px + wide.middle).astype(np.float32)
    query = replace(shown, xy=xy, size=(wide.height, wide.width))
    pose = pose_by(query, keypoints_of(made.keypoints[12], KEY), points_of(made.keypoints[12]), wide)
    assert pose is not None
    assert (pose.right_m, pose.ahead_m, pose.turn_rad) == pytest.approx((0, 0, 0), abs=0.02)


def test_only_a_map_with_keypoints_is_of_version_5_and_earlier_ones_read_as_before(tmp_path: Path) -> None:
    build(tmp_path / "map", places=20)
    with MapBuilder(tmp_path / "old", MODEL, REGIONS, SamplingConfig()) as builder:
        builder.begin_segment("drive", "front")
        for row in range(2):
            builder.add(np.ones((2, 16), np.float32), Place(row))
        builder.finish()
    new, old = (json.loads((tmp_path / name / HEADER).read_text()) for name in ("map", "old"))
    assert (new["version"], old["version"]) == (5, 4)
    assert "keypoints" not in old
    assert open_map(tmp_path / "old").keypoints is None


def test_extending_keeps_the_old_distances_and_tiles_have_their_own(tmp_path: Path) -> None:
    made = build(tmp_path / "map")
    with MapBuilder(tmp_path / "more", MODEL, REGIONS, SamplingConfig(), keypoints=lambda *_: KEY) as builder:
        add_map(builder, made)
        builder.finish()
    assert bytes_of(open_map(tmp_path / "more").keypoints) == bytes_of(made.keypoints)
    assert [header.version for header in split_map(made, tmp_path / "tiles", 128)] == [5, 5]
    tiles = [open_map(path, every_file=True) for path in sorted((tmp_path / "tiles").iterdir())]
    assert b"".join(bytes_of(tile.keypoints) for tile in tiles) == bytes_of(made.keypoints)


def test_pictures_of_two_shapes_are_no_map_with_keypoints(tmp_path: Path) -> None:
    with (
        pytest.raises(MapError, match="of 320 x 180 and of 320 x 240 pixels: a map with keypoints has those of one"),
        MapBuilder(tmp_path / "map", MODEL, REGIONS, SamplingConfig(), keypoints=lambda *_: KEY) as builder,
    ):
        assert builder.keypoints is not None
        builder.keypoints.add(keypoints_at(0)[0])
        builder.keypoints.add(replace(keypoints_at(0)[0], size=(180, 320)))
    assert not (tmp_path / "map").exists()
