"""Where a vehicle is on a drive of the map that its camera sees from the other side, by what stands along both.

    used frames -> keypoints -> points of the last 40 m, by the odometer -> cells -> StructureMatch
    the map's places, with points, around the place that is believed ----> cells ->

Where a place is believed, it finds the vehicle within SEARCH_M of it. Before, it votes for one, see `StructureSearch`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np
from msgspec import UnsetType
from numpy.typing import NDArray

from edge.config import Config
from edge.keypoints import CameraModel, Keypoints, MapPoints
from edge.keypoints.drive_points import points_of_drive, reckoned
from edge.keypoints.mount import Mount, mount_of_drive
from edge.keypoints.network import KeypointNetwork
from edge.keypoints.points import REACH_M
from edge.recognition.structure_search import LONGEST_M, SHORTEST_M, StructureSearch
from edge.reference_map import MapSet
from edge.reference_map.keypoint_records import points_of
from edge.sequence import PlaceMatch
from edge.structure import StructureMatch
from edge.structure.cells import USUAL_M, Fit, best_fit
from edge.structure.path import FARTHEST_M, DrivePath

WINDOW_M, LAG_M = 40.0, 10.0
"""Of the vehicle's path, which is compared, and what lies between its end and the newest frame."""
SEARCH_M = 20.0
"""Along the drive, to each side of where the place that is believed has the vehicle."""
APART_M = 20.0
"""Driven between two matches."""
VOTES_APART_M = 4.0
"""Driven between two votes: one takes as long as the points of a frame."""
UNIQUE, SHARPNESS, CLEAR_MARGIN = 0.05, 0.1, 1.0
"""What a vote by structure says, in terms of one by a sequence: uniqueness over 1 a standard deviation of margin,
and from which margin on the newest frame supports the place. On the map .9 of the margins are 1 to 6, elsewhere 0 to 2.
"""
MOST_OF_FRAME = 300
"""Keypoints of a picture: as many as a map keeps of a place."""
KEPT_PLACES = 256
"""Whose points stay in memory, 3 kB each."""

Image = NDArray[np.uint8]
Floats = NDArray[np.float64]


class _Row:
    """A used frame: where it was, its keypoints, and their points once they are known."""

    def __init__(self, along_m: float, ground_m: tuple[float, float], keypoints: Keypoints) -> None:
        self.along_m, self.ground_m, self.keypoints = along_m, ground_m, keypoints
        self.points: MapPoints | None = None


class StructureMatcher:
    """Matches the shape of the street along the newest frames with that along a drive of the map."""

    def __init__(
        self, map_set: MapSet, config: Config, network_of: Callable[[], KeypointNetwork], apart_m: float = APART_M
    ) -> None:
        """network_of: opens it when it is first needed. apart_m: driven between two matches, at least."""
        self._config, self._network_of, self._apart_m = config, network_of, apart_m
        self.grow(map_set)
        self._search = StructureSearch(map_set, config, self._read_place)
        self.reset()

    def grow(self, map_set: MapSet) -> None:
        """Match with a set from now on that has further places after those so far; for these there are no votes."""
        self._map_set = map_set
        self._path = lru_cache(2)(self._read_path)
        self._place = lru_cache(KEPT_PLACES)(self._read_place)

    def reset(self) -> None:
        """No frame so far counts."""
        self._rows: list[_Row] = []
        self._mount: Mount | None = None
        self._matched_m = self._voted_m = -math.inf
        self._is_alike = False  # the place that is believed, and the vehicle's views

    def add(self, image: Image, ground_m: tuple[float, float] | None) -> PlaceMatch | None:
        """Add a used frame; the place that fits it best each VOTES_APART_M, None where too little was driven.

        image: (H, W, 3) uint8 BGR. ground_m: meters east and north by the odometer, None where not known. MapError for
        a map that was cut off.
        """
        if ground_m is None or self._is_alike:
            self.reset()
            return None
        self._add(image, ground_m)
        return self._vote() if self._search.read_on() else None

    def match(self, believed: PlaceMatch | None) -> StructureMatch | None:
        """Where the vehicle was in the middle of the window by the place that is believed; None where nothing fits."""
        if believed is None or not believed.accepted:
            self._is_alike = False
            return None
        self._is_alike = not self.is_opposed(believed)
        return self._match(believed) if self._rows and not self._is_alike else None

    def is_opposed(self, match: PlaceMatch) -> bool:
        """Whether the vehicle passes the place of a match with its camera the other way, and its map has keypoints."""
        index = self._map_set.index
        if self._map_set.headers[index.map_of(match.place_index)].keypoints_key is None:
            return False
        is_alike = index.view(index.segment_of(match.place_index)) == self._config.camera.view
        return is_alike != (match.direction == "forward")

    def _add(self, image: Image, ground_m: tuple[float, float]) -> None:
        step_m = math.dist(ground_m, self._rows[-1].ground_m) if self._rows else 0.0
        if step_m > REACH_M:
            self.reset()
        along_m = self._rows[-1].along_m + step_m if self._rows else 0.0
        self._rows.append(_Row(along_m, ground_m, self._network_of().extract(image, MOST_OF_FRAME)))
        self._place_rows(along_m - REACH_M)
        self._rows = [row for row in self._rows if row.along_m >= along_m - LAG_M - LONGEST_M - FARTHEST_M]

    def _vote(self) -> PlaceMatch | None:
        now_m = self._rows[-1].along_m
        window_m = 2 * math.floor(min(LONGEST_M, now_m - LAG_M - self._rows[0].along_m) / 2)
        if window_m < SHORTEST_M or now_m - self._voted_m < VOTES_APART_M:
            return None
        self._voted_m, since_m = now_m, LAG_M + window_m / 2
        fit = self._search.best(self._own_points() - (now_m - since_m, 0.0, 0.0), window_m)
        if fit is None:
            return None
        sign = 1 if fit.direction == "forward" else -1
        first, end = self._map_set.index.segment(fit.drive)
        along_m = fit.along_m + sign * (since_m + self._config.rig.ahead_m(fit.direction, "swapped"))
        place = first + int(np.abs(self._map_set.places["route_m"][first:end] - along_m).argmin())
        evidence = 1 + UNIQUE * fit.margin, SHARPNESS, 0.0 if fit.margin > CLEAR_MARGIN else 1.0
        return PlaceMatch(place, place, fit.direction, "swapped", 1.0, 0.0, *evidence)

    def _match(self, believed: PlaceMatch) -> StructureMatch | None:
        now_m = self._rows[-1].along_m
        middle_m = now_m - LAG_M - WINDOW_M / 2
        is_full = now_m - self._rows[0].along_m >= LAG_M + WINDOW_M + REACH_M
        if now_m - self._matched_m < self._apart_m or not is_full:
            return None
        sign = 1 if believed.direction == "forward" else -1
        route_m = float(self._map_set.places["route_m"][believed.place_index])
        ahead_m = self._config.rig.ahead_m(believed.direction, believed.order)
        expected_m = route_m - sign * (ahead_m + now_m - middle_m)
        if math.isnan(expected_m):
            return None
        points = self._own_points() - (middle_m, 0.0, 0.0)
        points[:, :2] *= sign
        fit = best_fit(points, self._points_around(believed.place_index, expected_m), expected_m, WINDOW_M, SEARCH_M)
        found = None if fit is None else self._as_match(fit, believed.place_index, middle_m)
        # Not at each frame until one fits by chance: one of 15 handed on was 3.9 m off, then none of 14 over 1.6 m.
        self._matched_m = now_m if found else now_m - self._apart_m / 2
        return found

    def _as_match(self, fit: Fit, place_index: int, middle_m: float) -> StructureMatch | None:
        """None where the window is not all on the drive of the map."""
        first, end = self._map_set.index.segment(self._map_set.index.segment_of(place_index))
        route_m = self._map_set.places["route_m"][first:end]
        if not route_m[0] <= fit.along_m - WINDOW_M / 2 <= fit.along_m + WINDOW_M / 2 <= route_m[-1]:
            return None
        nearest = int(np.abs(route_m - fit.along_m).argmin())
        at_m = np.array([row.along_m for row in self._rows])
        frames = len(at_m) - 1 - float(np.interp(middle_m, at_m, np.arange(len(at_m))))
        where = first + nearest, fit.along_m - float(route_m[nearest]), fit.left_m
        return StructureMatch(*where, frames, fit.sigma_m, fit.score)

    def _own_path(self) -> DrivePath:
        ground_m = np.array([row.ground_m for row in self._rows])
        east_m, north_m = np.gradient(ground_m, axis=0).T if len(ground_m) > 1 else np.zeros((2, 1))
        return DrivePath(np.array([row.along_m for row in self._rows]), ground_m, np.arctan2(east_m, north_m))

    def _place_rows(self, up_to_m: float) -> None:
        """Find the points of the rows that have enough others to both sides."""
        rows, path = self._rows, self._own_path()
        which = [number for number, row in enumerate(rows) if row.points is None and row.along_m <= up_to_m]
        camera, faces_back = self._camera(rows[-1].keypoints.size), self._faces_back
        found = points_of_drive(
            lambda row: rows[row].keypoints,
            *(path.along_m, path.heading, camera, which),
            faces_back=faces_back,
            mount=self._mount,
        )
        for row, (points, mount) in zip(which, found, strict=True):
            rows[row].points, self._mount = points, mount_of_drive([mount], self._mount)

    @property
    def _faces_back(self) -> bool:
        return self._config.camera.view == "rear"

    def _camera(self, size: tuple[int, int]) -> CameraModel:
        camera = self._config.camera
        if not isinstance(camera.fov_deg, UnsetType):
            return CameraModel(size[1], size[0], camera.fov_deg, camera.alone)
        key = next(header.keypoints_key for header in self._map_set.headers if header.keypoints_key is not None)
        return CameraModel(size[1], size[0], key.fov_deg, key.alone)

    def _own_points(self) -> Floats:
        """Along, left and up (n, 3) of the points of the newest frames."""
        path, mount = self._own_path(), self._mount
        assert mount is not None
        turned = (row.points.turned(mount.rotation.T) for row in self._rows if row.points is not None)
        found = [path.points_of(row, points, faces_back=self._faces_back) for row, points in enumerate(turned)]
        return np.concatenate(found)

    def _points_around(self, place_index: int, along_m: float) -> Floats:
        """The same of a place's drive, around a point of it."""
        index = self._map_set.index
        first, end = index.segment(index.segment_of(place_index))
        reach_m = WINDOW_M / 2 + SEARCH_M + USUAL_M + FARTHEST_M
        rows = np.searchsorted(self._map_set.places["route_m"][first:end], [along_m - reach_m, along_m + reach_m])
        found = [self._place(first + row) for row in range(int(rows[0]), int(rows[1]))]
        return np.concatenate([np.empty((0, 3)), *found])

    def _read_path(self, segment: int) -> DrivePath:
        rows = self._map_set.places[slice(*self._map_set.index.segment(segment))]
        route_m, heading = rows["route_m"].astype(np.float64), np.radians(rows["heading_deg"].astype(np.float64))
        return DrivePath(route_m, np.stack(reckoned(route_m, heading), axis=1), heading)

    def _read_place(self, place: int) -> Floats:
        index = self._map_set.index
        segment = index.segment_of(place)
        first, _ = index.segment(segment)
        points = points_of(self._map_set.keypoints_of(place))
        return self._path(segment).points_of(place - first, points, faces_back=index.view(segment) == "rear")
