"""The recognizer's matches on a drive with known positions, compared with where the vehicle was."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from edge.config import Config, RigConfig
from edge.descriptor.network import Network
from edge.errors import FeedError, MapError
from edge.feed import Feed
from edge.geodesy import east_north
from edge.localization.place_fix import OdometryWindow, sequence_midpoint
from edge.recognition.recognizer import open_recognizer
from edge.reference_map import MapSet, Route
from edge.reference_map.store import ReferenceMap
from edge.sequence import Direction, Order, PlaceMatch
from sim.evaluation.replay import config_for_feed
from sim.traverse import traverse

ALIKE_M, ALIKE_SHARE = 3.0, 0.2
"""A line is as long as what was driven if both differ by at most so many meters and that share, of which a tenth is for
the odometer of a recorded drive."""

OFF_ROUTE_M = 30.0
"""A vehicle further than this from the map's drive was not on it."""

SAME_ROAD_M = 15.0
"""Where a drive passes the same road twice, stretches up to this much further away count as equally near."""


@dataclass(frozen=True)
class OffsetSample:
    """One match of the recognizer.

    ahead_m: meters along the map's drive, in the direction of travel, from the vehicle to the refined end of the line;
    NaN where the vehicle was not on that drive. left_m: how far left of the map's drive the vehicle drove, seen in its
    own direction of travel; NaN like ahead_m. line_sigma_m: standard deviation of the line's end without the rig's; NaN
    where the daemon would not use the line. place_m: of the place along the map's drive. pose_m: meters that the camera
    is ahead of the vehicle by the pose of this frame alone, NaN where it has none.
    """

    direction: Direction
    order: Order
    ahead_m: float
    confidence: float
    accepted: bool
    left_m: float = float("nan")
    line_sigma_m: float = 0.0
    place_m: float = 0.0
    pose_m: float = float("nan")


def samples_of(reference_map: ReferenceMap, feed: Feed, config: Config, network: Network) -> Iterator[OffsetSample]:
    """Every match of a row and a place whose positions are known, in order. FeedError and MapError where none are."""
    places = reference_map.places
    is_known = ~(np.isnan(places["lat_deg"]) | np.isnan(places["route_m"]))
    if not is_known.any():
        raise MapError(f"{reference_map.path}: no place has a position and meters, so nothing can be measured along it")
    if all(row.lat_deg is None or row.lon_deg is None for row in feed.rows):
        raise FeedError(f"{feed.path / 'frames.csv'}: no row has lat_deg and lon_deg; calibrate with GPS on")
    config = config_for_feed(msgspec.structs.replace(config, rig=RigConfig()), feed)  # measured without any offset
    recognizer = open_recognizer(config, network=network, map_set=MapSet.of(reference_map))
    drives = MapDrives(reference_map, feed)
    route, readings = Route(recognizer.map_set), OdometryWindow(config.sequence_frames)
    for item in traverse(feed, config.sampling):
        match = item.match(recognizer)
        if item.distance_m is None:
            readings.clear()
        elif recognizer.is_in_line:
            readings.add(np.array([item.distance_m]))
        if match is not None and is_known[match.place] and item.row.lat_deg is not None:
            sign = 1 if match.direction == "forward" else -1
            beyond_m, sigma_m = _refined(match, route, readings)
            ahead_m = sign * drives.further_m(item.frame.index, match.place) + beyond_m
            left_m = sign * drives.left_m(item.frame.index, match.place)
            pose_m = _pose_m(match, drives, item.frame.index, faces_back=config.camera.view == "rear")
            kind, belief = (match.direction, match.order), (match.confidence, match.accepted)
            place_m = float(places["route_m"][match.place])
            yield OffsetSample(*kind, ahead_m, *belief, left_m, sigma_m, place_m, pose_m)


def _pose_m(match: PlaceMatch, drives: MapDrives, row: int, *, faces_back: bool) -> float:
    """How far ahead of the vehicle a keypoint pose has the camera, along the map's drive."""
    if match.seen is None:
        return float("nan")
    sign = 1 if match.direction == "forward" else -1
    ahead_m = -match.seen.ahead_m if faces_back else match.seen.ahead_m
    return sign * drives.further_m(row, match.seen.place_index) + ahead_m


def _refined(match: PlaceMatch, route: Route, readings: OdometryWindow) -> tuple[float, float]:
    """How far beyond its place a match ends in the direction of travel, by its midpoint and the odometer; its sigma.

    0 and NaN for a match that the daemon would not use, or that is not as long as what was driven.
    """
    middle = sequence_midpoint(match, route, len(readings)) if len(readings) > 1 else None
    if middle is None:
        return 0.0, float("nan")
    driven_m = float((readings.back(0) - readings.back(2 * middle.back))[0])
    length_m = abs(middle.ends_m - middle.begins_m)
    if abs(length_m - driven_m) > ALIKE_M + ALIKE_SHARE * driven_m:
        return 0.0, float("nan")
    return (driven_m - length_m) / 2, middle.sigma_m


class MapDrives:
    """The drives of a map as lines on the ground, and a feed's positions projected onto them.

    A line has no pieces where places have no position.
    """

    def __init__(self, reference_map: ReferenceMap, feed: Feed) -> None:
        places = reference_map.places
        lat_deg = np.concatenate([places["lat_deg"], np.array([row.lat_deg for row in feed.rows], dtype=float)])
        lon_deg = np.concatenate([places["lon_deg"], np.array([row.lon_deg for row in feed.rows], dtype=float)])
        meters = east_north(lat_deg, lon_deg)
        self._places_m, self._vehicle_m = meters[: len(places)], meters[len(places) :]
        self._route_m: NDArray[np.float64] = places["route_m"]
        segments = reference_map.header.segments
        self._segment_of = np.repeat(np.arange(len(segments)), [segment.end - segment.start for segment in segments])

    def further_m(self, row: int, place: int) -> float:
        """Meters along the place's drive from the vehicle at a row of the feed to the place; NaN off that drive."""
        drive = self._segment_of == self._segment_of[place]
        nearest_m, route_m = _project(self._vehicle_m[row], self._places_m[drive], self._route_m[drive])
        if nearest_m.min() > OFF_ROUTE_M:
            return float("nan")
        # Each passing of the road is a run of pieces, and has one nearest point; of these the one at the place counts.
        near = np.flatnonzero(nearest_m <= nearest_m.min() + SAME_ROAD_M)
        passings = np.split(near, np.flatnonzero(np.diff(near) > 1) + 1)
        further_m = [float(self._route_m[place] - route_m[run[nearest_m[run].argmin()]]) for run in passings]
        return min(further_m, key=abs)

    def left_m(self, row: int, place: int) -> float:
        """Meters that the vehicle was left of the place's drive, as the map's driver has it; NaN off that drive."""
        drive = self._segment_of == self._segment_of[place]
        line, point = self._places_m[drive], self._vehicle_m[row]
        nearest_m, _ = _project(point, line, self._route_m[drive])
        if nearest_m.min() > OFF_ROUTE_M:
            return float("nan")
        piece = int(nearest_m.argmin())
        (east, north), (off_east, off_north) = line[piece + 1] - line[piece], point - line[piece]
        return float((east * off_north - north * off_east) / max(np.hypot(east, north), 1e-9))


def _project(
    point: NDArray[np.float64], line: NDArray[np.float64], along_m: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """For each piece of a line (N, 2): distance of the point (2,) from it, and how far along the line it is nearest.

    The nearest point of the whole line is exact; on the ends of the line it is the end. Infinite where a piece has no
    positions.
    """
    start, step = line[:-1], np.diff(line, axis=0)
    length_sq = np.maximum(np.square(step).sum(axis=1), 1e-9)
    share = np.clip(((point - start) * step).sum(axis=1) / length_sq, 0.0, 1.0)
    distance_m = np.linalg.norm(start + share[:, np.newaxis] * step - point, axis=1)
    distance_m[np.isnan(distance_m + along_m[:-1] + along_m[1:])] = np.inf
    return distance_m, along_m[:-1] + share * np.diff(along_m)
