"""Poses and structure as measurements of their own, for autopilots that fuse them; GPS that poses contradict. Pure."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from edge.geodesy import Origin, moved
from edge.journal.records import PlaceFix
from edge.localization.dead_reckoning import Odometry
from edge.localization.events import ImageProcessed
from edge.localization.filter import CORRELATION_M, left_of
from edge.localization.pose_measurement import PoseMeasurement, Vector
from edge.localization.state import DriveErrors, Matrix

FIRST = 2
"""Keypoint poses that must agree before the first one counts: a geometry may have two solutions."""
HOLE_S = 8.0
"""Without a keypoint pose for so long, FIRST must agree again before one is handed on: EKF3 takes the first one after
10 s for its position, whatever it was before (`posTimeout` and `ResetPosition` of its source). And so long those that
have outvoted where the vehicle was are on probation: five in a bend of road 990 agreed 7 to 8 m behind it."""
DEPARTS_M, SURE_M = 2.5, 1.5
"""By how much more than usual GPS is away from keypoint poses that know the vehicle to SURE_M before it is left where
poses are fused. An honest GPS that wanders by a meter was left in none of 34 drives of 1.2 km, by 2.0 m in two. Where
GPS had to be suspect by its evidence, which lets the map be wrong in its place, a vehicle that GPS misled by 1 m/s was
11 m beside its lane by then, and lost (road 996)."""


class FixCandidate(NamedTuple):
    """A position that may be asked for, and the vehicle's motion at its moment; None: not known.

    pose_sigma_m: of a keypoint pose, its standard deviation in the direction where that is largest, without the error
    of the map, which is in `place`.
    """

    place: PlaceFix | None = None
    motion: Odometry | None = None
    pose_sigma_m: float | None = None


class FusedPoses:
    """The keypoint poses that passed the innovation test since the last reset."""

    def __init__(self) -> None:
        self.newest = FixCandidate()
        """The newest pose that may be fused."""
        self._agreeing, self._posed_ns = 0, 0  # that passed without a hole, and the newest
        self._corrected_ns: float = -math.inf  # when they outvoted where the vehicle was
        self._usual_off_m: Vector | None = None  # GPS from the poses, and how many in a row are elsewhere
        self._departing = 0

    def outvote(self, stamp_ns: int) -> None:
        """They have outvoted where the vehicle was."""
        self._corrected_ns = stamp_ns

    def are_on_probation(self, stamp_ns: int) -> bool:
        """Whether they have outvoted where the vehicle was, for less than HOLE_S: they may be outvoted again.

        None is handed on then, and no position speaks against those that are right afterward.
        """
        return stamp_ns - self._corrected_ns < HOLE_S * 1e9

    def leave_gps(self, stamp_ns: int) -> None:
        """Those that contradicted GPS have agreed."""
        self._departing, self._agreeing, self._posed_ns = 0, FIRST - 1, stamp_ns

    def contradict_gps(self, pose: PoseMeasurement, gps_m: Vector | None, since_pose_m: float) -> bool:
        """Whether GPS is away from keypoint poses by so much more than usual, FIRST times in a row.

        What is usual is the error of the map, and of the receiver, by the poses of the last CORRELATION_M. gps_m: None
        while GPS does not count. since_pose_m: driven since the pose before.
        """
        if gps_m is None:
            self._usual_off_m = None
            return False
        if float(np.trace(pose.covariance)) > SURE_M**2:
            return False
        off_m, usual_m = gps_m - pose.position_m, self._usual_off_m
        if usual_m is None or float(np.hypot(*(off_m - usual_m))) <= DEPARTS_M:
            news = 1.0 if usual_m is None else min(1.0, since_pose_m / CORRELATION_M)
            self._usual_off_m = off_m if usual_m is None else usual_m + news * (off_m - usual_m)
            self._departing = 0
        else:
            self._departing += 1
        return self._departing >= FIRST

    def add(
        self, pose: PoseMeasurement, errors: DriveErrors, at: ImageProcessed, fix: PlaceFix | None, origin: Origin
    ) -> None:
        """One passed. fix: the filter's position then; of the newest pose nothing of the filter's past is in it."""
        self._agreeing = self._agreeing + 1 if at.stamp_ns - self._posed_ns <= HOLE_S * 1e9 else 1
        self._posed_ns, self.newest = at.stamp_ns, FixCandidate()
        if self._agreeing >= FIRST:
            self.hand_on(pose.position_m, pose.covariance, pose.heading_rad, errors, at, fix, origin)

    def hand_on(
        self,
        position_m: Vector,
        covariance: Matrix,
        heading_rad: float,
        errors: DriveErrors,
        at: ImageProcessed,
        fix: PlaceFix | None,
        origin: Origin,
    ) -> None:
        """A measurement of its own: where the vehicle is (2,), and its covariance (2, 2) without those errors."""
        self.newest = FixCandidate()
        if fix is None or self.are_on_probation(at.stamp_ns):
            return
        lat_deg, lon_deg = moved(*origin, float(position_m[0]), float(position_m[1]))
        axes = np.array([[math.sin(heading_rad), math.cos(heading_rad)]])
        axes = np.concatenate([axes, left_of(axes)])
        of_map = errors.map_m**2 * np.eye(2) + errors.whole
        along_m, cross_m = np.sqrt((axes @ (covariance + of_map) @ axes.T).diagonal())
        place = replace(
            fix,
            lat_deg=lat_deg,
            lon_deg=lon_deg,
            heading_deg=math.degrees(heading_rad) % 360,
            sigma_along_m=float(along_m),
            sigma_cross_track_m=float(cross_m),
        )
        self.newest = FixCandidate(place, at.motion, math.sqrt(float(np.linalg.eigvalsh(covariance)[-1])))
