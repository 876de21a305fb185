"""Keypoint poses by cameras that are not as the config says.

One wide camera is rendered for a drive; the pictures of each other camera are taken from its own, pixel by pixel. All
frames of a drive go through the recognizer's own verification, one after another, which is told the right neighborhood.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

import edge
from edge.config import CameraConfig, Config, Lens
from edge.feed import FeedImages, read_feed
from edge.keypoints import CameraModel
from edge.keypoints.intrinsics import CameraDifference
from edge.recognition.place_verification import PlaceVerification
from edge.reference_map import Drives, MapSet
from sim.research.evaluation import poses
from sim.world.recording import recorded
from sim.world.scenario import LightName, Scenario

WIDE = CameraModel(640, 480, 112.0)
CONFIGURED = CameraModel(320, 240, 80.0)
CAMERAS = {
    f"{fov_deg:g} degrees, k1 {k1:g}" if k1 else f"{fov_deg:g} degrees": (fov_deg, k1)
    for fov_deg, k1 in ((80, 0), (70, 0), (84, 0), (88, 0), (90, 0), (80, -0.05), (80, -0.15))
}
LIGHTS: tuple[LightName, ...] = ("dusk", "night")


class _Drive(NamedTuple):
    """Of (n, 3) right, ahead and turned: what poses are off by, and their sigmas; and what they say of the camera."""

    off: NDArray[np.float64]
    sigmas: NDArray[np.float64]
    found: CameraDifference | None


def rows(args: argparse.Namespace) -> Iterator[str]:
    """What keypoint poses are off by where the camera is not as the config says: 80 degrees, no k1."""
    yield (
        "| camera | poses | along-track | sigma | cross-track | beyond 3, 4 sigma | heading | field of view found"
        " | k1 found |"
    )
    yield "|---" * 9 + "|"
    drives = [*product(args.seeds, poses.DRIVES, LIGHTS)]
    for name, (fov_deg, k1) in CAMERAS.items():
        camera = CONFIGURED._replace(fov_deg=fov_deg, lens=_lens(k1))
        yield _row(name, [_drive(args.cache, *one, camera) for one in drives])
    yield f"\nMade by Lookback {edge.__version__}."


def _lens(k1: float) -> Lens:
    return Lens(distortion=(k1, 0.0, 0.0, 0.0)) if k1 else Lens()


def _row(name: str, drives: Sequence[_Drive]) -> str:
    off, sigmas = (np.concatenate([one[index] for one in drives]) for index in (0, 1))
    *position, heading = np.abs(off / sigmas).T
    spread = np.maximum(*position)
    (right, nearly_right), (ahead, nearly_ahead) = np.percentile(np.abs(off[:, :2]), (50, 95), axis=0).T
    found = [one.found for one in drives if one.found is not None]
    return (
        f"| {name} | {len(off)} | {ahead:.2f} / {nearly_ahead:.2f} m | {np.median(sigmas[:, 1]):.2f} m"
        f" | {right:.2f} / {nearly_right:.2f} m | {(spread > 3).sum()}, {(spread > 4).sum()}"
        f" | {(heading > 3).sum()}, {(heading > 4).sum()}"
        f" | {_range([one.fov_deg for one in found], 1)} | {_range([one.k1 for one in found], 2)} |"
    )


def _range(values: Sequence[float], digits: int) -> str:
    """From the least to the greatest; "-" where no drive has found one."""
    return f"{min(values):.{digits}f} to {max(values):.{digits}f}" if values else "-"


def _drive(folder: Path, road: int, drive: str, light: LightName, camera: CameraModel) -> _Drive:
    view, made = poses.DRIVES[drive]
    scenario = replace(made, seed=road, light=light, fov_deg=WIDE.fov_deg, width=WIDE.width, height=WIDE.height)
    query = recorded(replace(scenario, length_m=poses.LENGTH_M), folder, poses.QUERY_M)
    return _verified(MapSet.of(poses.mapped(folder, Scenario(road, poses.LENGTH_M), view)), query, camera)


def _verified(map_set: MapSet, query: Path, camera: CameraModel) -> _Drive:
    """Each frame in turn, by a vehicle whose config says CONFIGURED."""
    config = Config(camera=CameraConfig(fov_deg=CONFIGURED.fov_deg))
    verification = PlaceVerification(config)
    verification.use_maps(map_set, Drives(map_set, config.sampling.spacing_m))
    seen_by, feed = _pixels(camera), read_feed(query)
    images, where = FeedImages(feed), poses.Truth(map_set)
    off, sigmas = [], []
    for index, row in enumerate(feed.rows):
        picture = np.asarray(cv2.remap(images.read(index), *seen_by, cv2.INTER_LINEAR), np.uint8)
        seen = verification.verify(picture, where.near(row))
        if seen is not None:
            off.append(where.off(row, seen.place_index, seen.right_m, seen.ahead_m, seen.turn_rad))
            sigmas.append(np.sqrt(np.diag(seen.covariance)))
    images.close()
    return _Drive(np.array(off), np.array(sigmas), verification.camera)


def _pixels(camera: CameraModel) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Columns and rows of the wide camera's picture, as `cv2.remap` has them."""
    own = np.stack(np.meshgrid(np.arange(float(camera.width)), np.arange(camera.height)), axis=-1)
    columns, rows_ = np.moveaxis(camera.directions(own) * WIDE.focal_px + WIDE.middle, -1, 0).astype(np.float32)
    return columns, rows_
