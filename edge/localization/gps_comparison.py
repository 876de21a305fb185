"""GPS against one recognized place, and how likely the difference is if GPS is honest or wrong. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.geodesy import east_north_of
from edge.localization.anchor import Anchor
from edge.localization.dead_reckoning import Displacement

OFFSETS_M = (20.0, 50.0, 300.0)
"""Scales of the offset of a wrong GPS: what first shows beside the errors of places, and what a spoofer ends with."""
ANYWHERE = 2e-15
"""Per square meter: anywhere on Earth. No honest offset is less likely than a thousandth of that."""
BURST_SHARE, BURST_M = 0.05, 5.0
"""Share of the sightings in a burst of multipath, and one standard deviation of it east and north: 10 m are two."""


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
