"""Errors of keypoint poses: the pose of each picture, against the recording's own positions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.config import RigConfig
from edge.geodesy import east_north
from edge.reference_map import MapSet
from edge.sequence import KeyframeMatch
from sim.evaluation.recognition import Recognition


@dataclass(frozen=True)
class PoseErrors:
    """Meters (n,) of n poses, along the drive's direction of travel and to its right; the vehicle's, not the camera's.

    frames: (n,) rows of them among the used frames.
    """

    frames: NDArray[np.intp]
    along_m: NDArray[np.float64]
    cross_track_m: NDArray[np.float64]


def pose_errors(maps: MapSet, seen: Recognition, rig: RigConfig) -> PoseErrors:
    """Of the poses at places with a position and a heading, where the recording has a position as well.

    rig: how far the camera is ahead of the vehicle, as the map's was of its own.
    """
    found = []
    for frame, (one, used) in enumerate(zip(seen.keyframes, seen.used, strict=True)):
        row = seen.feed.rows[used.frame]
        if one is None or row.lat_deg is None or row.lon_deg is None:
            continue
        off_m = _off_m(maps, one, row.lat_deg, row.lon_deg)
        if used.direction == "reverse":  # of travel, against the map's drive
            off_m = -off_m
        if used.direction is not None and np.isfinite(off_m).all():
            found.append((frame, off_m[1] - rig.look_ahead_m(used.direction), off_m[0]))
    frames, along_m, cross_track_m = np.array(found, dtype=float).reshape(-1, 3).T
    return PoseErrors(frames.astype(np.intp), along_m, cross_track_m)


def _off_m(maps: MapSet, seen: KeyframeMatch, lat_deg: float, lon_deg: float) -> NDArray[np.float64]:
    """Meters (2,) to the right of the drive of a place, and along it, from a position to the camera by its pose."""
    place, index = maps.places[seen.place_index], maps.index
    meters = east_north(np.array([lat_deg, place["lat_deg"]]), np.array([lon_deg, place["lon_deg"]]))
    heading = np.radians(float(place["heading_deg"]))
    axes = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
    facing = 1 if index.view(index.segment_of(seen.place_index)) == "front" else -1
    found: NDArray[np.float64] = axes @ (meters[1] - meters[0]) + facing * np.array([seen.right_m, seen.ahead_m])
    return found
