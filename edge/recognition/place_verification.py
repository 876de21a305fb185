"""Geometric verification: which of some places of the map a picture shows, by keypoints of both, and its pose there.

    picture -> keypoints -> matches with each candidate -> poses by the best, and by the best elsewhere
            -> the same pose by rows around the best

A candidate has keypoints of the network that ships, and its camera faced as the vehicle's does.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np
from msgspec import UnsetType
from numpy.typing import NDArray

from edge.config import Config, Lens
from edge.descriptor.model_file import read_model_file, resolve_model
from edge.keypoints import CameraModel, Keypoints
from edge.keypoints.intrinsics import DOUBTFUL, SHARED, UNSEEN, WRONG, CameraDifference, CameraEvidence
from edge.keypoints.matching import mutual_matches
from edge.keypoints.network import NETWORK, KeypointNetwork
from edge.keypoints.pose import STARTS, RelativePose, pose_to_keyframe
from edge.keypoints.view_geometry import Intrinsics
from edge.reference_map import Drives, MapSet
from edge.reference_map.keypoint_file import KeypointsKey
from edge.reference_map.keypoint_records import keypoints_of, points_of
from edge.sequence import MOST_OFF_COURSE_RAD, Correspondences, Direction, KeyframeMatch
from edge.sequence.keyframe_consensus import ENOUGH, confidence_of

MOST_OF_FRAME = 300
"""Keypoints of a picture: as many as a map keeps of a place."""
VERIFIED = 3
"""Candidates with most matches that a pose is sought by, which takes 18 times as long as to match them. On the way home
on a rear camera's map (two roads, 480 frames) the best of 3 of 30 was right in .88, of 10 of 30 in .91; of 3 of 10 in
.84, and in .80 where the best was the one of most matches that one fundamental matrix explains."""
OTHER_PLACE_M, MOST_ELSEWHERE = 20.0, 0.3
"""What a place so far away may have of the best one's support, by the best of RIVALS poses there. It was at most 0.19
of it on the way home at night, 0.68 in the median on a street that repeats every 54 m (81 and 90 pictures over 3). By 3
poses, with 0.5, 16 of 250 frames on the way home along that street are believed, 6 of them wrong, with 0.3 6 and 6.
"""
RIVALS = 6
"""Candidates elsewhere with most matches that a pose is sought by as well: the right place need not be among the first.
By 3 of them, 6 of 250 frames home at night on that street are believed, 324 m off; by 6 none. A frame that looks for
its place takes 1.16 times as long, 1.4 times as without any."""
ROWS_M = -4.0, 4.0, -8.0, 8.0
"""Along the drive, to the rows that are asked for the same pose."""
ROWS_APART_M, ROWS_TURNED_RAD = 2.0, math.radians(5)
"""By which their poses may differ."""
HOPS, NEAR_M = 2, 1.5
"""How often a pose that lies further ahead of its place, or behind it, is taken again from the place nearest to it."""
MOST_RIGHT_M, MOST_AHEAD_M, MOST_TURN_RAD = 8.0, 8.0, math.radians(25)
"""Of a pose on the road of its place: in another lane, between two places, in a bend."""


class PlaceVerification:
    """Pictures of one camera against the places of some maps."""

    def __init__(self, config: Config) -> None:
        self._view, self._only = config.camera.view, config.sequence.directions
        camera = config.camera
        self._camera = None if isinstance(camera.fov_deg, UnsetType) else (camera.fov_deg, camera.alone)
        self._evidence: dict[tuple[float, Lens], CameraEvidence] = {}
        """What pictures said of each camera that the config, or a map where it has none, says the vehicle has."""
        self.camera: CameraDifference | None = None
        """What pictures said of the vehicle's camera, once they are enough."""
        self._newest: tuple[Keypoints, int, RelativePose] | None = None
        self.alike: tuple[KeyframeMatch, ...] = ()
        """Two places far apart that the newest verification could not tell apart; none if it could."""

    def use_maps(self, map_set: MapSet, drives: Drives) -> None:
        """Verify against the places of these maps from now on; drives: theirs."""
        self._map_set, self._drives = map_set, drives
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
        """Of travel past a place in which the vehicle's camera faces as that of the place did."""
        return "forward" if self._view_of(place) == self._view else "reverse"

    def facing(self, place: int) -> int:
        """1 where the place's camera faced along its drive, -1 where it faced back."""
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
        return math.cos(heading_rad - course_rad) >= math.cos(MOST_OFF_COURSE_RAD)

    def verify(self, image: NDArray[np.uint8], places: Sequence[int]) -> KeyframeMatch | None:
        """The place that a picture (H, W, 3) uint8 BGR shows, of some candidates and those around them; None: none.

        MapError for a map that was cut off.
        """
        query = self.network.extract(image, MOST_OF_FRAME)
        self.alike, self._newest = (), None
        found = self._found(query, places)
        if found is None:
            return None
        place, pose = found
        for _ in range(HOPS):
            nearer = self._row_at(place, self.facing(place) * pose.ahead_m) if abs(pose.ahead_m) > NEAR_M else place
            again = None if nearer == place else self._pose(query, nearer, self._from(nearer, place, pose))
            if again is None or not (_is_on_the_road(again) and _support_of(again) > _support_of(pose)):
                break
            place, pose = nearer, again
        self._newest = query, place, pose
        return _seen(place, self._by_any_camera(query, place, pose), self._support(query, place, pose))

    def _by_any_camera(self, query: Keypoints, place: int, pose: RelativePose) -> RelativePose:
        """A pose that is as wide as its camera is in doubt, by what earlier pictures say and by this one.

        Solved for by any camera as well, since points that are off by the one so far would say that it is right.
        """
        evidence, by_config = self._evidence_at(place), _as_supported(pose)
        own = self._pose(query, place, pose.start, evidence.open)
        if own is None or own.intrinsics is None:
            return by_config
        camera = self._camera_at(place)
        self._evidence[camera] = after = evidence.with_picture(own.intrinsics, share=_share_of(own) / SHARED)
        self.camera = after.difference(camera[0]) or self.camera
        doubt = evidence.with_picture(own.intrinsics, share=_share_of(own)).doubt
        if evidence.doubt > WRONG or doubt < DOUBTFUL:
            return by_config  # or already by the camera that was found
        other = self._pose(query, place, pose.start, evidence.known)
        return by_config if other is None else by_config.mixed(_as_supported(other), doubt)

    def _found(self, query: Keypoints, places: Sequence[int]) -> tuple[int, RelativePose] | None:
        """The candidate with most support, and the pose by it; None: none, or one elsewhere is nearly as good."""
        alike = sorted(((self._matches(query, place), place) for place in places), reverse=True)
        tried: dict[int, RelativePose | None] = {}

        def support_at(place: int) -> float:
            if place not in tried:
                tried[place] = self._pose(query, place)
            pose = tried[place]
            return _support_of(pose) if pose and _is_on_the_road(pose) else 0.0

        for _, place in alike[:VERIFIED]:
            if support_at(place) >= ENOUGH:
                break
        best = max(tried, key=support_at)
        if support_at(best) == 0.0:
            return None
        elsewhere = [place for _, place in alike if self._is_elsewhere(place, best)]
        best = max([*tried, *elsewhere[:RIVALS]], key=support_at)
        rivals = [place for place in tried if self._is_elsewhere(place, best)]
        rival = max(rivals, key=support_at, default=best)
        if rival != best and support_at(rival) > MOST_ELSEWHERE * support_at(best):
            both = ((place, tried[place]) for place in (best, rival))
            self.alike = tuple(_seen(place, pose, _support_of(pose)) for place, pose in both if pose)
            return None
        pose = tried[best]
        return None if pose is None else (best, pose)

    def _is_elsewhere(self, place: int, other: int) -> bool:
        return self._drives.apart_m(place, other) > OTHER_PLACE_M

    def _support(self, query: Keypoints, place: int, pose: RelativePose) -> float:
        """That a pose has by its place and by the rows around it whose own pose is the same one, up to ENOUGH."""
        support = _support_of(pose)
        for row in dict.fromkeys(self._row_at(place, along_m) for along_m in ROWS_M):
            if support >= ENOUGH:
                break
            start = self._from(row, place, pose)
            found = None if row == place else self._pose(query, row, start)
            if found is not None:
                right_m, ahead_m, turn = np.array([found.right_m, found.ahead_m, found.turn_rad]) - start[0]
                if math.hypot(right_m, ahead_m) <= ROWS_APART_M and abs(turn) <= ROWS_TURNED_RAD:
                    support += _support_of(found)
        return support

    @property
    def correspondences(self) -> Correspondences | None:
        """Of the newest verification, None without a match; computed when asked for: only people read it."""
        if self._newest is None:
            return None
        query, place, pose = self._newest
        assert pose.pairs is not None  # of `pose_to_keyframe`
        pairs = ((query, 0), (keypoints_of(self._record(place), self._key(place)), 1))
        rows = pose.pairs[pose.inlier_mask]
        return Correspondences(place, np.hstack([one.xy[rows[:, side]] / one.size[::-1] for one, side in pairs]))

    def _matches(self, query: Keypoints, place: int) -> int:
        return len(mutual_matches(query.descriptors, self._record(place)["descriptor"]))

    def _pose(
        self, query: Keypoints, place: int, starts: NDArray[np.float64] = STARTS, known: Intrinsics | None = None
    ) -> RelativePose | None:
        key, record = self._key(place), self._record(place)
        height = round(key.width * query.size[0] / query.size[1])
        camera = CameraModel(key.width, height, *self._camera_at(place))
        if known is None and (evidence := self._evidence_at(place)).doubt > WRONG:
            known = evidence.known
        return pose_to_keyframe(query, keypoints_of(record, key), points_of(record), camera, starts, known)

    def _evidence_at(self, place: int) -> CameraEvidence:
        return self._evidence.get(self._camera_at(place), UNSEEN)

    def _camera_at(self, place: int) -> tuple[float, Lens]:
        """Field of view and lens of the vehicle's camera; where the config does not say it, those of the map's."""
        key = self._key(place)
        return self._camera or (key.fov_deg, key.alone)

    def _row_at(self, place: int, along_m: float) -> int:
        """The place of the same drive that lies nearest to so many meters further along it."""
        first, end = self._map_set.index.segment(self._map_set.index.segment_of(place))
        route_m = self._map_set.places["route_m"][first:end]
        return first + int(np.abs(route_m - route_m[place - first] - along_m).argmin())

    def _from(self, row: int, place: int, pose: RelativePose) -> NDArray[np.float64]:
        """A pose by a place as another row of its drive has it (1, 3): on the chord of an arc between the two."""
        moved = self._map_set.places[[place, row]]
        along_m, turned_deg = (float(np.diff(moved[name])[0]) for name in ("route_m", "heading_deg"))
        turned = 0.0 if math.isnan(turned_deg) else math.remainder(math.radians(turned_deg), 2 * math.pi)
        along_m *= self.facing(place)
        right_m, ahead_m = pose.right_m - along_m * math.sin(turned / 2), pose.ahead_m - along_m * math.cos(turned / 2)
        cos, sin = math.cos(turned), math.sin(turned)
        return np.array([[cos * right_m - sin * ahead_m, sin * right_m + cos * ahead_m, pose.turn_rad - turned]])

    def _record(self, place: int) -> NDArray[np.void]:
        return self._map_set.keypoints_of(place)

    def _key(self, place: int) -> KeypointsKey:
        key = self._keys[self._map_set.index.map_of(place)]
        assert key is not None  # of a candidate
        return key


def _seen(place: int, pose: RelativePose, support: float) -> KeyframeMatch:
    where = pose.right_m, pose.ahead_m, pose.turn_rad, pose.covariance
    return KeyframeMatch(place, *where, pose.inliers, confidence_of(support))


def _is_on_the_road(pose: RelativePose) -> bool:
    return (
        abs(pose.right_m) <= MOST_RIGHT_M and abs(pose.ahead_m) <= MOST_AHEAD_M and abs(pose.turn_rad) <= MOST_TURN_RAD
    )


def _as_supported(pose: RelativePose) -> RelativePose:
    """The wider the less its own row supports it.

    Other rows show that the place is right, not that the pose is: one recorded drive has 55 positions without that, up
    to 3.3 sigma off, 124 with it, up to 2.6.
    """
    return replace(pose, covariance=pose.covariance / _share_of(pose))


def _share_of(pose: RelativePose) -> float:
    """Of the support that is enough."""
    return float(min(1.0, _support_of(pose) / ENOUGH))


def _support_of(pose: RelativePose) -> float:
    """That a row of the map gives to a pose: its points, each as much as those agree that it is one of."""
    return pose.inliers * float(pose.inlier_mask.mean()) ** 2
