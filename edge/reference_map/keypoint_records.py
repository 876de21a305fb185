"""A place's records of KEYPOINT as the stage of keypoints has them, and back."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from edge.keypoints import CameraModel, Keypoints, MapPoints
from edge.reference_map.keypoint_file import KEYPOINT, STEPS, KeypointsKey


def camera_of(key: KeypointsKey) -> CameraModel:
    """The camera of a map's pictures."""
    return CameraModel(key.width, key.height, key.fov_deg, key.alone)


def record_of(keypoints: Keypoints, key: KeypointsKey) -> NDArray[np.void]:
    """Records (K,) of a picture's keypoints, whose distances are not known yet."""
    record = np.zeros(key.most, KEYPOINT)
    record["inverse"] = record["sigma"] = np.nan
    xy = keypoints.xy * (key.width / keypoints.size[1])
    directions = camera_of(key).directions(xy)
    ahead = np.flatnonzero(np.isfinite(directions).all(axis=1))[: key.most]
    count = len(ahead)
    record["descriptor"][:count] = keypoints.descriptors[ahead]
    record["xy"][:count] = np.rint(xy[ahead].clip(0) * STEPS)
    record["direction"][:count] = directions[ahead]
    return record


def keypoints_of(record: NDArray[np.void], key: KeypointsKey) -> Keypoints:
    """The keypoints of a place. Scores are in their order."""
    used = record["descriptor"].any(axis=-1)
    xy = record["xy"][used].astype(np.float32) / np.float32(STEPS)
    scores = np.linspace(1, 0, len(xy), endpoint=False, dtype=np.float32)
    return Keypoints(xy, scores, np.ascontiguousarray(record["descriptor"][used]), (key.height, key.width))


def points_of(record: NDArray[np.void]) -> MapPoints:
    """Its points, in the order of `keypoints_of`."""
    record = record[record["descriptor"].any(axis=-1)]
    places = np.column_stack([record["direction"], record["inverse"]]).astype(np.float64)
    return MapPoints(places, record["sigma"].astype(np.float64))


def put_points(record: NDArray[np.void], points: MapPoints) -> None:
    """Write the points of a place's keypoints into its records."""
    own = record[: len(points.sigma)]
    own["direction"], own["inverse"], own["sigma"] = points.places[:, :2], points.places[:, 2], points.sigma
