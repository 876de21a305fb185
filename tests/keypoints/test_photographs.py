"""Keypoints of real pictures: photographs, a stereo pair with its distances, and drives along photographs."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from msgspec.structs import replace
from numpy.typing import NDArray

import lookback
from edge.config import Lens
from edge.feed import FeedImages, read_feed
from edge.feed.writer import FeedWriter
from edge.keypoints import CameraModel, MapPoints
from edge.keypoints.pose import pose_to_keyframe
from tests.photographs import Image, PhotographedStreet, drive, photograph, shipped

FOCAL_PX, BASELINE, MIDDLES_X = 994.978, 1.93001, (311.193, 342.279)
"""Of the stereo pair (Scharstein et al. 2014), in pixels and decimeters, which stand for meters as on a road."""
EUROC, FOV_DEG = Lens(distortion=(-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05)), 78.7
"""The lens of the left camera of EuRoC's MAV."""
SIZE, STRAIGHT_SIZE, STRAIGHT_DEG = (320, 240), (480, 360), 105.0
ROAD_M = 28.0


def test_a_photograph_is_found_again_in_another_view_of_it() -> None:
    """Turned, smaller, and seen from the side: half of the inliers are within 1.5 pixels of where they must be."""
    image = photograph("coffee")
    height, width = image.shape[:2]
    moved = np.array([[0.82, -0.14, 60], [0.10, 0.80, 20], [1.5e-4, -1e-4, 1]])
    again = np.asarray(cv2.warpPerspective(image, moved, (width, height)), np.uint8)
    one, other = lookback.keypoints(image), lookback.keypoints(again)
    found = lookback.verify(one, other)
    assert found.inliers > 100
    there = cv2.perspectiveTransform(one.xy[found.matches[:, 0]][np.newaxis].astype(float), moved)[0]
    off_px = np.linalg.norm(there - other.xy[found.matches[:, 1]], axis=1) * 320 / width
    assert np.median(off_px) < 1.5
    others = (photograph(name) for name in ("chelsea", "astronaut", "rocket", "brick"))
    assert max(lookback.verify(one, picture).inliers for picture in others) < 30


def centered(image: NDArray[Any], middle_x: float) -> tuple[NDArray[Any], CameraModel]:
    """The part of a picture whose middle looks straight ahead, and its camera."""
    half = round(min(middle_x, image.shape[1] - 1 - middle_x))
    left = round(middle_x) - half
    part = image[:, left : left + 2 * half + 1]
    fov_deg = float(np.degrees(2 * np.arctan(part.shape[1] / 2 / FOCAL_PX)))
    return part, CameraModel(part.shape[1], part.shape[0], fov_deg)


def test_the_pose_of_a_stereo_pair_is_its_baseline() -> None:
    """Distances by its true disparities; the right camera stands 1.93 to the right, not ahead, and not turned."""
    (left, camera), (right, other) = (
        centered(photograph(f"motorcycle_{side}"), middle)
        for side, middle in zip(("left", "right"), MIDDLES_X, strict=True)
    )
    with np.load(shipped("motorcycle_disp.npz")) as file:
        disparity = centered(file["arr_0"], MIDDLES_X[0])[0]
    place, query = lookback.keypoints(left), lookback.keypoints(right)
    assert lookback.verify(query, place).inliers > 100
    column, row = place.xy.round().astype(int).T
    inverse = (disparity[row, column] + np.diff(MIDDLES_X)[0]) / FOCAL_PX / BASELINE
    known = np.isfinite(inverse) & (inverse > 0)
    places = np.column_stack([camera.directions(place.xy), np.where(known, inverse, np.nan)])
    points = MapPoints(places, np.where(known, 0.5 / FOCAL_PX / BASELINE, np.nan))
    found = pose_to_keyframe(query, place, points, other)
    assert found is not None
    assert found.right_m == pytest.approx(BASELINE, abs=0.1)
    assert found.ahead_m == pytest.approx(0, abs=0.3)
    assert np.degrees(found.turn_rad) == pytest.approx(0, abs=0.3)


@cache
def through_lens() -> NDArray[np.float32]:
    """Where each pixel of a picture through EuRoC's lens is in one of STRAIGHT_SIZE: x, y, (H, W, 2)."""
    wide, camera = CameraModel(*STRAIGHT_SIZE, STRAIGHT_DEG), CameraModel(*SIZE, FOV_DEG, EUROC)
    pixels = np.stack(np.meshgrid(*(np.arange(float(side)) for side in SIZE)), axis=-1)
    return (camera.directions(pixels) * wide.focal_px + wide.middle).astype(np.float32)


def bent(straight: Image) -> Image:
    """A picture of STRAIGHT_SIZE as EuRoC's lens shows it."""
    at = through_lens()
    return np.asarray(cv2.remap(straight, at[..., 0], at[..., 1], cv2.INTER_AREA), np.uint8)


@pytest.fixture(scope="module")
def street() -> PhotographedStreet:
    return PhotographedStreet(ROAD_M, seed=3)


@pytest.fixture(scope="module")
def maps(
    street: PhotographedStreet, make_once: Callable[[str, Callable[[Path], object]], Path]
) -> dict[str, lookback.Map]:
    """Of one drive without a lens, by a lens that is known, and by one that is not."""

    def fill(folder: Path) -> None:
        along_m = np.arange(0.0, ROAD_M, 2.0)
        drive(street, folder / "straight", along_m, fov_deg=FOV_DEG)
        drive(street, folder / "wide", along_m, size=STRAIGHT_SIZE, fov_deg=STRAIGHT_DEG)
        for name, lens in (("straight", Lens()), ("known", EUROC), ("unknown", Lens())):
            feed = lookback_feed(folder / ("straight" if name == "straight" else "wide"), folder / name, lens)
            lookback.Map.build(feed, folder / f"{name}_map")

    folder = make_once("bent", fill)
    return {name: lookback.Map.open(folder / f"{name}_map") for name in ("straight", "known", "unknown")}


def lookback_feed(source: Path, path: Path, lens: Lens) -> Path:
    """A feed as recorded through EuRoC's lens, whose header has some lens; that of a straight one is itself."""
    if source == path:
        return path
    feed = read_feed(source)
    images = FeedImages(feed)
    header = replace(
        feed.header, width=SIZE[0], height=SIZE[1], fov_deg=FOV_DEG, lens=lens.lens, distortion=lens.distortion
    )
    with FeedWriter(path, header) as writer:
        for index, row in enumerate(feed.rows):
            writer.write(bent(images.read(index)), row)
    images.close()
    return path


def error_m(made: lookback.Map, street: PhotographedStreet, *, bends: bool, lens: Lens) -> float:
    """What poses of some pictures half a meter beside and ahead of places are off by, in the median."""
    found = []
    for place in range(3, round(ROAD_M / 2) - 2, 2):
        at_m = 2.0 * place + 0.5
        picture = street.picture(0.5, at_m, *((STRAIGHT_SIZE, STRAIGHT_DEG) if bends else (SIZE, FOV_DEG)))
        pose = made.pose(
            bent(picture) if bends else picture, place, fov_deg=FOV_DEG, lens=lens.lens, distortion=lens.distortion
        )
        found.append((np.inf, np.inf) if pose is None else (pose.right_m - 0.5, pose.ahead_m - 0.5))
    return float(np.median(np.linalg.norm(found, axis=1)))


def test_poses_through_a_lens_are_as_good_as_without_if_it_is_known(
    maps: dict[str, lookback.Map], street: PhotographedStreet
) -> None:
    straight = error_m(maps["straight"], street, bends=False, lens=Lens())
    known = [
        error_m(maps["straight"], street, bends=True, lens=EUROC),
        error_m(maps["known"], street, bends=True, lens=EUROC),
        error_m(maps["known"], street, bends=False, lens=Lens()),
    ]
    unknown = [
        error_m(maps["straight"], street, bends=True, lens=Lens()),
        error_m(maps["unknown"], street, bends=False, lens=Lens()),
    ]
    assert straight < 0.1
    assert max(known) < 2 * straight + 0.05
    assert min(unknown) > 2 * max(known)
