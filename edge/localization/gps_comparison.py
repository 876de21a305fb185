"""GPS against one recognized place, and how likely the difference is if GPS is honest or wrong. Pure.

A look says where the vehicle is. A line says how far along the map's drive it is; across it, only that it is on the
road, in its lane. Neither uses GPS or the autopilot's velocity, which a spoofed GPS would carry along. So GPS is
compared with the newest place of a line, although its middle is known better: the middle would have to be moved on by
that velocity.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.config import RigConfig
from edge.geodesy import Origin, east_north_of, moved, moved_left
from edge.localization.anchor import Anchor
from edge.localization.dead_reckoning import Displacement
from edge.localization.events import GpsFix
from edge.localization.look import Look
from edge.localization.place_fix import line_middle, map_error_m, match_position
from edge.localization.route_estimate import left_of
from edge.localization.sighting import Sighting, Sightings
from edge.reference_map import Route
from edge.sequence import PlaceMatch

OFFSETS_M = (20.0, 50.0, 300.0)
"""Scales of the offset of a wrong GPS: what first shows beside the errors of places, and what a spoofer ends with."""
ANYWHERE = 2e-15
"""Per square meter: anywhere on Earth. No honest offset is less likely than a thousandth of that."""
BURST_SHARE, BURST_M = 0.05, 5.0
"""Share of the sightings in a burst of multipath, and one standard deviation of it east and north: 10 m are two."""
SECOND_M = 0.8
"""What looks are wrong by beside their covariance: a tenth of them are a second solution, 2.5 m off."""


@dataclass(frozen=True)
class Comparison:
    """GPS less place, at one exposure: meters along the road and to its left, with one standard deviation of each.

    lat_deg, lon_deg: where the match says that the vehicle is. spacing_m: between places of the map, of which a frame
    passes about one. heading_rad: of travel. off_*_m: None without GPS. each_sigma_m: of the less certain of both by
    itself. motion: the vehicle's own, without GPS, None if unknown. shape: the recording, if it keeps its shape.
    look_sigma_m: of the look in each direction, None of a line. slow_sigma_m: of map and GPS, which change slowly.
    whole_sigma_m: of what turns with the way, along and across together. place_sigma_m: of the look and the map.
    """

    lat_deg: float
    lon_deg: float
    spacing_m: float
    heading_rad: float
    off_along_m: float | None
    off_left_m: float | None
    along_sigma_m: float
    left_sigma_m: float
    each_sigma_m: float
    motion: Displacement | None = None
    shape: str = ""
    stamp_s: float = 0.0
    look_sigma_m: float | None = None
    slow_sigma_m: float = 0.0
    whole_sigma_m: float = 0.0
    place_sigma_m: float = 0.0

    @property
    def axes(self) -> NDArray[np.float64]:
        """Unit vectors, east and north, along the road and to its left: (2, 2)."""
        sin, cos = math.sin(self.heading_rad), math.cos(self.heading_rad)
        return np.array([[sin, cos], [-cos, sin]])


def evidence_of(comparison: Comparison) -> float:
    """Logarithm of how much more likely its offset is if GPS is wrong than if it is honest."""
    assert comparison.off_along_m is not None and comparison.off_left_m is not None
    off_along_m, off_left_m = comparison.off_along_m, comparison.off_left_m
    along, left = comparison.along_sigma_m, comparison.left_sigma_m
    honest = (1 - BURST_SHARE) * _normal(off_along_m, along) * _normal(off_left_m, left)
    honest += (
        BURST_SHARE * _normal(off_along_m, math.hypot(along, BURST_M)) * _normal(off_left_m, math.hypot(left, BURST_M))
    )
    wrong = sum(
        _normal(off_along_m, math.hypot(along, scale_m)) * _normal(off_left_m, math.hypot(left, scale_m))
        for scale_m in OFFSETS_M
    ) / len(OFFSETS_M)
    return math.log((wrong + ANYWHERE) / max(honest, ANYWHERE / 1000))


def offset_m(comparison: Comparison) -> NDArray[np.float64]:
    """GPS less place, meters east and north (2,)."""
    assert comparison.off_along_m is not None and comparison.off_left_m is not None
    offset: NDArray[np.float64] = np.array([comparison.off_along_m, comparison.off_left_m]) @ comparison.axes
    return offset


def meters_from(here: Comparison, there: Comparison | Anchor) -> NDArray[np.float64]:
    """East and north (2,), from one place to another."""
    return np.array(east_north_of(there.lat_deg, there.lon_deg, (here.lat_deg, here.lon_deg)))


def _normal(value: float, sigma: float) -> float:
    return math.exp(-((value / sigma) ** 2) / 2) / (sigma * math.sqrt(math.tau))


class _Place(NamedTuple):
    """Where a match has the vehicle, its direction of travel, and one standard deviation along it, across, and each.

    map_m: of the map in each direction, which is in the others. whole_m: of all looks at its drive, along and across
    together. look_m: of a look without these, None of a line.
    """

    lat_deg: float
    lon_deg: float
    heading_rad: float
    along_m: float
    left_m: float
    map_m: float
    whole_m: float = 0.0
    look_m: float | None = None


def compare(
    match: PlaceMatch, looked: Sighting | None, gps: GpsFix | None, sightings: Sightings, undated_m: float = 0.0
) -> Comparison | None:
    """GPS less place at the newest frame of a match; None where it is not believed, or its line may be pushed.

    looked: what its picture says, which counts if it is of the same place. undated_m: see `Sighting`.
    """
    if not match.accepted:
        return None
    route, place = sightings.route, None
    is_of_it = looked is not None and (looked.match.seen, looked.match.direction) == (match.seen, match.direction)
    if is_of_it and looked is not None and looked.look is not None and sightings.origin is not None:
        place = _by_look(looked, looked.look, sightings.origin)
    elif line_middle(match, route, sightings.length) is not None:
        place = _by_line(match, route, sightings.rig, undated_m)
    if place is None:
        return None
    gps_m, off_along_m, off_left_m = 0.0, None, None
    sin, cos = math.sin(place.heading_rad), math.cos(place.heading_rad)
    if gps is not None:
        east_m, north_m = east_north_of(gps.lat_deg, gps.lon_deg, (place.lat_deg, place.lon_deg))
        gps_m, off_along_m, off_left_m = gps.sigma_m, east_m * sin + north_m * cos, north_m * sin - east_m * cos
    drive = route.drive(match.place_index)
    return Comparison(
        lat_deg=place.lat_deg,
        lon_deg=place.lon_deg,
        spacing_m=drive.spacing_m,
        heading_rad=place.heading_rad,
        off_along_m=off_along_m,
        off_left_m=off_left_m,
        along_sigma_m=math.hypot(place.along_m, gps_m),
        left_sigma_m=math.hypot(place.left_m, gps_m),
        each_sigma_m=max(place.along_m, place.left_m, gps_m),
        shape=drive.recording if drive.checked_m > 0 else "",
        look_sigma_m=place.look_m,
        slow_sigma_m=math.hypot(place.map_m, gps_m),
        whole_sigma_m=place.whole_m,
        place_sigma_m=0.0 if place.look_m is None else math.hypot(place.look_m, place.map_m),
    )


def _by_look(looked: Sighting, look: Look, origin: Origin) -> _Place:
    along, spread = looked.passed.along, look.covariance + look.whole + look.map_sigma_m**2 * np.eye(2)
    left = left_of(along)
    return _Place(
        *moved(*origin, float(look.position_m[0]), float(look.position_m[1])),
        heading_rad=math.atan2(along[0], along[1]),
        along_m=math.hypot(math.sqrt(float(along @ spread @ along)), looked.undated_m),
        left_m=math.sqrt(float(left @ spread @ left)),
        map_m=look.map_sigma_m,
        whole_m=math.hypot(math.sqrt(float(np.trace(look.whole))), looked.undated_m),
        look_m=math.hypot(math.sqrt(float(np.trace(look.covariance)) / 2), SECOND_M),
    )


def _by_line(match: PlaceMatch, route: Route, rig: RigConfig, undated_m: float) -> _Place | None:
    place = match_position(match, route, rig)
    if place is None or place.heading_deg is None:
        return None
    whole_along_m, whole_across_m = route.drive(match.place_index).whole_sigma_m
    match_m, map_m = rig.sigma_m(match.direction, match.order), map_error_m(place)
    return _Place(
        *moved_left(place.lat_deg, place.lon_deg, place.heading_deg, rig.left_m(match.direction)),
        heading_rad=math.radians(place.heading_deg),
        along_m=math.hypot(match_m, map_m, undated_m, whole_along_m),
        left_m=math.hypot(rig.sigma_across_m, map_m, whole_across_m),
        map_m=map_m,
    )
