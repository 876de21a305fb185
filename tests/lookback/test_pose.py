"""`Map.pose` of pictures of a street whose camera looks beside the way it drives."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

import lookback
from edge.feed import FeedHeader, FeedRow
from edge.feed.writer import FeedWriter
from edge.keypoints import CameraModel

CAMERA = CameraModel(320, 240, 80.0)
TURNED_DEG = 4.0
PLACES, SPACING_M = 24, 2.0


def picture(ahead_m: float, right_m: float = 0.0, turn_deg: float = 0.0) -> NDArray[np.uint8]:
    """What the camera sees between two walls, 6 m to either side, of random blocks of half a meter and of two."""
    columns, rows = np.meshgrid(np.arange(CAMERA.width), np.arange(CAMERA.height))
    x, y = np.moveaxis(CAMERA.directions(np.stack([columns, rows], axis=-1)), -1, 0)
    turn = math.radians(turn_deg)
    x, z = math.cos(turn) * x + math.sin(turn), math.cos(turn) - math.sin(turn) * x
    with np.errstate(divide="ignore"):
        reach = np.stack([(6 - right_m) / x, (-6 - right_m) / x, 1.5 / y, (150 - ahead_m) / z])
    reach[reach <= 0] = np.inf
    surface, depth = reach.argmin(axis=0), reach.min(axis=0)
    across = np.where(surface == 2, right_m + depth * x, depth * y)
    along = np.where(surface == 3, right_m + depth * x, ahead_m + depth * z)
    shade = np.zeros((CAMERA.height, CAMERA.width, 3))
    for block_m, texture in zip((0.5, 2.0), np.random.default_rng(5).integers(0, 120, (2, 4, 64, 512, 3)), strict=True):
        shade += texture[
            surface, np.floor(across / block_m).astype(int) % 64, np.floor(along / block_m).astype(int) % 512
        ]
    return shade.astype(np.uint8)


@pytest.fixture(scope="module")
def mapped(tmp_path_factory: pytest.TempPathFactory) -> lookback.Map:
    """A drive whose heading is that of the road, and whose camera looks to the right of it."""
    folder = tmp_path_factory.mktemp("street")
    header = FeedHeader("street", "front", CAMERA.width, CAMERA.height, time_sigma_s=0.0, fov_deg=CAMERA.fov_deg)
    with FeedWriter(folder / "drive", header) as writer:
        for place in range(PLACES):
            at_m = place * SPACING_M
            row = FeedRow("", place * 10**8, -27 + at_m / 110_800, 153.0, heading_deg=0.0, distance_m=at_m)
            writer.write(picture(at_m, turn_deg=TURNED_DEG), row)
    return lookback.Map.build(folder / "drive", folder / "map", spacing_m=SPACING_M)


def test_the_picture_of_a_place_is_not_turned_from_it(mapped: lookback.Map) -> None:
    for place in range(6, 18, 3):
        found = mapped.pose(picture(place * SPACING_M, turn_deg=TURNED_DEG), place)
        assert found is not None
        assert abs(math.degrees(found.turn_rad)) < 0.3
        assert abs(found.turn_rad) < 4 * math.sqrt(found.covariance[2, 2]) + math.radians(0.1)


def test_a_pose_is_of_the_frame_of_the_places_camera(mapped: lookback.Map) -> None:
    """3 m further along the road, by a camera that looks along it."""
    turned = math.radians(TURNED_DEG)
    for place in (6, 9, 12):
        found = mapped.pose(picture(place * SPACING_M + 3.0), place)
        assert found is not None
        assert (found.right_m, found.ahead_m) == pytest.approx((-3 * math.sin(turned), 3 * math.cos(turned)), abs=0.15)
        assert math.degrees(found.turn_rad) == pytest.approx(-TURNED_DEG, abs=0.4)
