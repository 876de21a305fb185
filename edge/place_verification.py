"""One look: which of some places of the map a picture shows, by the points that both have, and from where.

    picture -> keypoints -> matches with each candidate -> one geometry for the best -> a pose by the best of these

A candidate has keypoints of the network that ships, and its camera looked the way that the vehicle's does.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path

import numpy as np
from msgspec import UnsetType
from numpy.typing import NDArray

from edge.config import Config
from edge.descriptor.model_file import read_model_file, resolve_model
from edge.keypoints import Camera, Keypoints
from edge.keypoints.matching import mutual_matches, verify
from edge.keypoints.network import NETWORK, KeypointNetwork
from edge.keypoints.pose import Pose, look
from edge.reference_map import MapSet
from edge.reference_map.keypoint_file import KeypointsKey
from edge.reference_map.keypoint_records import keypoints_of, points_of
from edge.sequence import MOST_ASIDE_RAD, Agreeing, Direction, Seen
from edge.sequence.looks import confidence_of

MOST = 300
"""Keypoints of a picture: as many as a map keeps of a place."""
VERIFIED = 3
"""Candidates with most matches whose geometry is compared, which takes eight times as long as to match them."""
HOPS, NEAR_M = 2, 1.5
"""How often a pose that lies further ahead of its place, or behind it, is taken again from the place nearest to it."""
MOST_RIGHT_M, MOST_AHEAD_M, MOST_TURN_RAD = 8.0, 8.0, math.radians(25)
"""Of a pose on the road of its place: in another lane, between two places, in a bend."""


class PlaceVerification:
    """Pictures of one camera against the places of some maps."""

    def __init__(self, config: Config) -> None:
        self._view, self._only = config.camera.view, config.sequence.directions
        fov_deg = config.camera.fov_deg
        self._fov_deg = None if isinstance(fov_deg, UnsetType) else fov_deg  # where it is not set, as the map's

        self._newest: tuple[Keypoints, int, Pose] | None = None

    def use_maps(self, map_set: MapSet) -> None:
        """Look for the places of these maps from now on."""
        self._map_set = map_set
        keys = [header.keypoints_key for header in map_set.headers]
        self._keys = [key if key is not None and key.sha256 == self._made_by else None for key in keys]
        self.is_possible = any(self._keys)
        """Whether any of the maps has keypoints that compare with those of a picture."""

    @cached_property
    def _made_by(self) -> str:
        return read_model_file(resolve_model(Path(NETWORK))).info.sha256

    @cached_property
    def network(self) -> KeypointNetwork:
        """Opened when it is first needed: a vehicle that meets its maps in opposite views never does."""
        return KeypointNetwork()

    def direction(self, place: int) -> Direction:
        """In which a vehicle passes a place whose camera looked the way that its own does."""
        return "forward" if self._view_of(place) == self._view else "reverse"

    def facing(self, place: int) -> int:
        """1 where the place's camera looked along its drive, -1 where it looked back."""
        return 1 if self._view_of(place) == "front" else -1

    def _view_of(self, place: int) -> str:
        index = self._map_set.index
        return index.view(index.segment_of(place))

    def candidates(self, places: NDArray[np.intp], course_rad: float | None, most: int, apart: int) -> list[int]:
        """The first `most` of some places that may be seen, `apart` places from each other.

        course_rad: of the vehicle; where it is known, those passed another way are none.
        """
        found: list[int] = []
        for place in places.tolist():
            if all(abs(place - one) >= apart for one in found) and self._may_be_seen(place, course_rad):
                found.append(place)
                if len(found) == most:
                    break
        return found

    def _may_be_seen(self, place: int, course_rad: float | None) -> bool:
        if self._keys[self._map_set.index.map_of(place)] is None:
            return False
        direction = self.direction(place)
        if self._only not in ("both", direction):
            return False
        heading_deg = float(self._map_set.places["heading_deg"][place])
        if course_rad is None or math.isnan(heading_deg):
            return True
        heading_rad = math.radians(heading_deg) + math.pi * (direction == "reverse")
        return math.cos(heading_rad - course_rad) >= math.cos(MOST_ASIDE_RAD)

    def look(self, image: NDArray[np.uint8], places: Sequence[int]) -> Seen | None:
        """The place that a picture (H, W, 3) uint8 BGR shows, of some candidates and those around them; None: none.

        MapError for a map that was cut off.
        """
        query = self.network.extract(image, MOST)
        alike = sorted(((self._matches(query, place), place) for place in places), reverse=True)[:VERIFIED]
        inliers, place = max((self._inliers(query, place), place) for _, place in alike)
        pose = self._pose(query, place)
        for _ in range(HOPS):
            if pose is None or abs(pose.ahead_m) <= NEAR_M:
                break
            nearer = self._nearest_to(place, pose)
            if nearer == place or (of_nearer := self._inliers(query, nearer)) <= inliers:
                break
            inliers, place, pose = of_nearer, nearer, self._pose(query, nearer)
        if pose is None or not _is_on_the_road(pose):
            self._newest = None
            return None
        self._newest = query, place, pose
        return self._seen(place, inliers, pose)

    @property
    def agreeing(self) -> Agreeing | None:
        """Of the newest look, None where it showed no place; for people, of whom most never ask."""
        if self._newest is None:
            return None
        query, place, pose = self._newest
        assert pose.pairs is not None  # of `look`
        pairs = ((query, 0), (keypoints_of(self._record(place), self._key(place)), 1))
        rows = pose.pairs[pose.agrees]
        return Agreeing(place, np.hstack([one.xy[rows[:, side]] / one.size[::-1] for one, side in pairs]))

    def _seen(self, place: int, inliers: int, pose: Pose) -> Seen:
        where = pose.right_m, pose.ahead_m, pose.turn, pose.covariance
        return Seen(place, inliers, *where, pose.count, confidence_of(pose.count, float(pose.agrees.mean()), inliers))

    def _matches(self, query: Keypoints, place: int) -> int:
        return len(mutual_matches(query.descriptors, self._record(place)["descriptor"]))

    def _inliers(self, query: Keypoints, place: int) -> int:
        return verify(query, keypoints_of(self._record(place), self._key(place))).inliers

    def _pose(self, query: Keypoints, place: int) -> Pose | None:
        key, record = self._key(place), self._record(place)
        height = round(key.width * query.size[0] / query.size[1])
        camera = Camera(key.width, height, self._fov_deg or key.fov_deg)
        return look(query, keypoints_of(record, key), points_of(record), camera)

    def _nearest_to(self, place: int, pose: Pose) -> int:
        """The place of the same drive that lies nearest along it to where a pose has the camera."""
        first, end = self._map_set.index.segment(self._map_set.index.segment_of(place))
        route_m = self._map_set.places["route_m"][first:end]
        at_m = route_m[place - first] + self.facing(place) * pose.ahead_m
        return first + int(np.abs(route_m - at_m).argmin())

    def _record(self, place: int) -> NDArray[np.void]:
        return self._map_set.keypoints_of(place)

    def _key(self, place: int) -> KeypointsKey:
        key = self._keys[self._map_set.index.map_of(place)]
        assert key is not None  # of a candidate
        return key


def _is_on_the_road(pose: Pose) -> bool:
    return abs(pose.right_m) <= MOST_RIGHT_M and abs(pose.ahead_m) <= MOST_AHEAD_M and abs(pose.turn) <= MOST_TURN_RAD
