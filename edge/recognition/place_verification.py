"""Geometric verification: which of some places of the map a picture shows, by keypoints of both, and its pose there.

    picture -> keypoints -> matches with each candidate -> poses by the best, and by the best elsewhere
                         -> one pose by the local map around it, or around where the vehicle is reckoned to be

A local map is a place and some of its drive around it. A candidate has keypoints of the network that ships, and
its camera faced as the vehicle's does.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
from msgspec import UnsetType
from numpy.typing import NDArray

from edge.config import Config, Lens
from edge.descriptor.model_file import read_model_file, resolve_model
from edge.keypoints import CameraModel, Keypoints, MapPoints
from edge.keypoints.drive_points import cameras_beside
from edge.keypoints.intrinsics import UNSEEN, WRONG, CameraDifference, CameraEvidence, by_any_camera
from edge.keypoints.lens import LensCheck
from edge.keypoints.matching import mutual_matches
from edge.keypoints.network import NETWORK, KeypointNetwork
from edge.keypoints.pose import STARTS, Keyframe, PointMatches, RelativePose, match_keyframes
from edge.reference_map import Drives, MapSet
from edge.reference_map.keypoint_file import KeypointsKey
from edge.reference_map.keypoint_records import keypoints_of, points_of
from edge.sequence import MOST_OFF_COURSE_RAD, Correspondences, Direction, KeyframeMatch
from edge.sequence.keyframe_consensus import ENOUGH, FAINT, confidence_of

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
KEPT_PLACES = 36
"""Whose points stay in memory, 32 kB each: those of four local maps."""
AROUND_M = 0.0, -2.0, 2.0, -4.0, 4.0, -6.0, 6.0, -8.0, 8.0
"""Along the drive, to the places of a local map. Of five, 4 m apart, 0.90 and 0.79 of the frames home at night were
known 5 and 6 m beside the lane (road 9671), with gaps of 12 and 22 m, of nine 0.94 and 0.85 (4 and 16 m) in the same
time. With 600 keypoints of a picture in place of 300 it would be 0.94 and 0.89, in 4 to 8 ms more."""
WIDE = np.array([(right, ahead, 0.0) for right in (-6.0, -3.0, 0.0, 3.0, 6.0) for ahead in (-6.0, 0.0, 6.0)])
"""Starts by a local map, as `STARTS`. From these, pictures 5 m beside the lane whose camera is turned by 10 degrees may
end in a second solution, 5 to 9 m further to the right (roads 9681 and 9683, night): 0.81 and 0.58 of the frames are
known, turned to the right and to the left, rms over sigma up to 2.2. With ten more starts, turned by 9 degrees, it was
0.91 and 0.77, and 0.9, but flown on 974 and 979, 26 of 928 poses were beyond three sigma, instead of 10 of 914."""


class PlaceVerification:
    """Pictures of one camera against the places of some maps."""

    def __init__(self, config: Config) -> None:
        self.lens = LensCheck()
        """What the pictures show of the camera."""
        self._view, self._only = config.camera.view, config.sequence.directions
        camera = config.camera
        self._camera = None if isinstance(camera.fov_deg, UnsetType) else (camera.fov_deg, camera.alone)
        self._evidence: dict[tuple[float, Lens], CameraEvidence] = {}
        """What pictures said of each camera that the config, or a map where it has none, says the vehicle has."""
        self._is_asked = False  # the newest picture, what camera it is of
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
        self._points = lru_cache(KEPT_PLACES)(self._read)

    @cached_property
    def _made_by(self) -> str:
        return read_model_file(resolve_model(Path(NETWORK))).info.sha256

    @cached_property
    def network(self) -> KeypointNetwork:
        """Opened when it is first needed: by a vehicle in opposite views only for `[sequence] structure`."""
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
        key, direction = self._keys[self._map_set.index.map_of(place)], self.direction(place)
        if key is None or self._only not in ("both", direction):
            return False
        heading_deg = float(self._map_set.places["heading_deg"][place])
        if course_rad is None or math.isnan(heading_deg):
            return True
        heading_rad = math.radians(heading_deg) + math.pi * (direction == "reverse")
        return math.cos(heading_rad - course_rad) >= math.cos(MOST_OFF_COURSE_RAD)

    def verify(self, image: NDArray[np.uint8], places: Sequence[int], near: Sequence[int] = ()) -> KeyframeMatch | None:
        """The place that a picture (H, W, 3) uint8 BGR shows, of some candidates and those around them; None: none.

        near: middles of local maps that are candidates as well. MapError for a map that was cut off.
        """
        query = self._keypoints_of(image)
        local = {middle: self._pose(self._matched(query, self._around(middle)), middle, WIDE) for middle in near}
        found = self._found(query, places, local)
        if found is None:
            return None
        place, pose = found
        nearer = self._row_at(place, self.facing(place) * pose.ahead_m)
        return self._seen(query, [nearer], np.vstack([self._from(nearer, place, pose), WIDE]))

    def follow(self, image: NDArray[np.uint8], middles: Iterable[int]) -> KeyframeMatch | None:
        """The place that a picture shows, of the local maps around some places where the vehicle is reckoned to be.

        As `verify`; no place elsewhere is tried. middles: at least one, and no further one than it takes.
        """
        return self._seen(self._keypoints_of(image), middles, WIDE)

    def _keypoints_of(self, image: NDArray[np.uint8]) -> Keypoints:
        self.alike, self._newest = (), None
        return self.lens.without_fixed(self.network.extract(image, MOST_OF_FRAME))

    def _seen(self, query: Keypoints, middles: Iterable[int], starts: NDArray[np.float64]) -> KeyframeMatch | None:
        """The match by the first local map with enough support, or that with most; None where none has any."""
        tried = []
        for middle in middles:
            found = self._matched(query, self._around(middle))
            tried.append((middle, found, self._pose(found, middle, starts)))
            if _support_of(tried[-1][2]) >= ENOUGH * FAINT:
                break
        place, matches, pose = max(tried, key=lambda one: _support_of(one[2]))
        if pose is None or _support_of(pose) == 0.0:
            return None
        self._newest = query, place, pose
        wide = self._by_any_camera(matches, place, pose).scaled(self._key(place).focal_sigma, query.sharpness)
        return _match(place, wide, _support_of(pose))

    def _by_any_camera(self, matches: PointMatches, place: int, pose: RelativePose) -> RelativePose:
        """As `by_any_camera`. Where the camera is right, every second picture is enough: neighbors err alike."""
        camera, evidence = self._camera_at(place), self._evidence_at(place)
        self._is_asked = not (self._is_asked and evidence.is_confirmed)
        if self._is_asked:
            pose, self._evidence[camera] = by_any_camera(matches, pose, evidence, ENOUGH)
            self.camera = self._evidence[camera].difference(camera[0]) or self.camera
        return pose

    def _found(
        self, query: Keypoints, places: Sequence[int], tried: dict[int, RelativePose | None]
    ) -> tuple[int, RelativePose] | None:
        """The candidate with most support, and the pose by it; None: none, or one elsewhere is nearly as good.

        tried: poses by candidates so far, by more than their own points.
        """
        seen = ((place, self._points(place)[0].descriptors) for place in places)
        alike = sorted(((len(mutual_matches(query.descriptors, one)), place) for place, one in seen), reverse=True)

        def support_at(place: int) -> float:
            if place not in tried:
                tried[place] = self._pose(self._matched(query, [(place, np.zeros(3))]), place)
            return _support_of(tried[place])

        for place in (*tried, *(place for _, place in alike[:VERIFIED])):
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
            self.alike = tuple(_match(place, pose, _support_of(pose)) for place, pose in both if pose)
            return None
        return (best, pose) if (pose := tried[best]) else None

    def _is_elsewhere(self, place: int, other: int) -> bool:
        return self._drives.apart_m(place, other) > OTHER_PLACE_M

    @property
    def correspondences(self) -> Correspondences | None:
        """Of the newest verification and the place itself, None without a match; computed when people ask for it."""
        if self._newest is None:
            return None
        query, place, pose = self._newest
        assert pose.pairs is not None  # of `PointMatches`
        pairs = ((query, 0), (self._points(place)[0], 2))
        rows = pose.pairs[pose.inlier_mask & (pose.pairs[:, 1] == 0)]
        return Correspondences(place, np.hstack([one.xy[rows[:, side]] / one.size[::-1] for one, side in pairs]))

    def _matched(self, query: Keypoints, places: Sequence[tuple[int, NDArray[np.float64]]]) -> PointMatches:
        """With places of one drive, each with its camera in the frame of the first of them."""
        key = self._key(first := places[0][0])
        keyframes = [Keyframe(*self._points(place), at) for place, at in places]
        height = round(key.width * query.size[0] / query.size[1])
        return match_keyframes(query, keyframes, CameraModel(key.width, height, *self._camera_at(first)))

    def _pose(self, matches: PointMatches, place: int, starts: NDArray[np.float64] = STARTS) -> RelativePose | None:
        """By the camera as it is known."""
        evidence = self._evidence_at(place)
        return matches.pose(starts, evidence.known if evidence.doubt > WRONG else None)

    def _around(self, place: int) -> list[tuple[int, NDArray[np.float64]]]:
        """The places of a local map, that in its middle first, and their cameras in its frame (3,)."""
        rows = list(dict.fromkeys(self._row_at(place, along_m) for along_m in AROUND_M))
        return [(row, at) for row, at in zip(rows, self._cameras_beside(rows), strict=True) if np.isfinite(at).all()]

    def _cameras_beside(self, places: Sequence[int]) -> NDArray[np.float64]:
        """Places of a drive as cameras (n, 3) in the frame of the first of them; NaN where that is not known."""
        first = min(places)
        own = [place - first for place in places]
        rows = self._map_set.places[first : max(places) + 1]
        at = cameras_beside(own, rows["route_m"], np.radians(rows["heading_deg"]), self.facing(places[0]))
        at[0] = 0.0
        return at

    def _from(self, row: int, place: int, pose: RelativePose) -> NDArray[np.float64]:
        """A pose by a place as another row of its drive has it (1, 3)."""
        beside = np.nan_to_num(self._cameras_beside([row, place])[1])
        return np.asarray(pose.turned(-float(beside[2])).start + beside * (1.0, 1.0, 0.0))

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

    def _read(self, place: int) -> tuple[Keypoints, MapPoints]:
        """A place's keypoints, and the points of those."""
        record = self._map_set.keypoints_of(place)
        return keypoints_of(record, self._key(place)), points_of(record)

    def _key(self, place: int) -> KeypointsKey:
        key = self._keys[self._map_set.index.map_of(place)]
        assert key is not None  # of a candidate
        return key


def _match(place: int, pose: RelativePose, support: float) -> KeyframeMatch:
    where = pose.right_m, pose.ahead_m, pose.turn_rad, pose.covariance
    return KeyframeMatch(place, *where, pose.inliers, confidence_of(support))


def _support_of(pose: RelativePose | None) -> float:
    return 0.0 if pose is None else pose.support
