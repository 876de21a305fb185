"""Where GPS and places agreed, and where the vehicle's own motion leads from there: the third witness. Pure."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.geodesy import east_north
from edge.localization.anchor import Anchor
from edge.localization.dead_reckoning import Displacement
from edge.localization.gps_comparison import Comparison, meters_from, offset_m
from edge.localization.look import HOLDS_M
from edge.localization.own_motion import Calibrated, calibrated
from edge.localization.route_estimate import CORRELATION_M

KEPT = 32  # of those that agreed
Array = NDArray[np.float64]


class _Agreed(NamedTuple):
    """A comparison that agreed, and the meters driven by then."""

    comparison: Comparison
    at_m: float


class Agreed:
    """Comparisons that agreed, as far apart as their errors are independent, but for the newest."""

    def __init__(self, drift: float) -> None:
        """drift: one standard deviation of the vehicle's own motion, as a share of the distance."""
        self._drift = drift
        self._kept: deque[_Agreed] = deque(maxlen=KEPT)
        self._calibrated: list[Calibrated | None] = []  # up to each of them, [] before it is needed

    def begin(self, anchor: Anchor) -> None:
        """If nothing has agreed before, GPS counts as right there."""
        if self._kept:
            return
        at, sigma_m = (anchor.lat_deg, anchor.lon_deg), anchor.sigma_m
        lost = Comparison(*at, 0.0, 0.0, 0.0, 0.0, sigma_m, sigma_m, sigma_m, anchor.displacement)
        self._kept.append(_Agreed(lost, -math.inf))
        self._calibrated.clear()

    def add(self, comparison: Comparison, at_m: float) -> None:
        """One that agreed, after so many meters."""
        kept, apart_m = self._kept, CORRELATION_M if comparison.look_sigma_m is None else HOLDS_M
        if len(kept) > 1 and math.hypot(*meters_from(kept[-2].comparison, kept[-1].comparison)) < apart_m:
            kept.pop()
        kept.append(_Agreed(comparison, at_m))
        self._calibrated.clear()

    def before(self, at_m: float) -> list[Comparison]:
        """Those of before a moment, the oldest first."""
        return [one.comparison for one in self._kept if one.at_m < at_m]

    def says(self, row: int, now: Comparison, lost: Anchor | None) -> float:
        """Logarithm of how much more likely the places moved as the vehicle did since one than GPS; 0: nobody knows.

        lost: where GPS was lost.
        """
        found = self._led(row, now, now.motion)
        if found is None:
            return 0.0
        where_m, covariance = found
        places_off_m = -where_m[:, 0]
        precision = precision_gps = np.linalg.inv(covariance + now.each_sigma_m**2 * np.eye(2))
        if lost is None:
            gps_off_m = offset_m(now) - where_m[:, 1]
        else:  # own motion was more certain then
            then = self._led(row, now, lost.displacement)
            if then is None:
                return 0.0
            gps_off_m = meters_from(now, lost) - then[0][:, 1]
            precision_gps = np.linalg.inv(then[1] + now.each_sigma_m**2 * np.eye(2))
        return float(gps_off_m @ precision_gps @ gps_off_m - places_off_m @ precision @ places_off_m) / 2

    def moved_on(self, lost: Anchor, now: Comparison) -> Comparison | None:
        """A comparison with where GPS would be, had it not been lost; None where own motion is not known."""
        led, led_then = self._led(-1, now, now.motion), self._led(-1, now, lost.displacement)
        if led is None or led_then is None:
            return None
        along_m, left_m = now.axes @ (meters_from(now, lost) + led[0][:, 1] - led_then[0][:, 1])
        along, left = np.sqrt(np.diag(now.axes @ led[1] @ now.axes.T) + lost.sigma_m**2)
        return replace(
            now,
            off_along_m=float(along_m),
            off_left_m=float(left_m),
            along_sigma_m=math.hypot(now.along_sigma_m, along),
            left_sigma_m=math.hypot(now.left_sigma_m, left),
            look_sigma_m=None,
        )

    def led_by(self, looks: Sequence[Comparison], motion: Displacement | None) -> tuple[Array, Array] | None:
        """Where own motion leads from looks, whatever GPS says: meters (2,) from the newest, and the covariance."""
        known = [(one, one.motion) for one in looks if one.motion is not None]
        if motion is None or not known:
            return None
        places_m = np.array([meters_from(known[-1][0], one) for one, _ in known])
        sigmas_m = np.array([[one.place_sigma_m] for one, _ in known])
        shown = calibrated([one for _, one in known], places_m[:, :, None], sigmas_m, self._drift)
        led = None if shown is None else shown.predicted(motion)
        return led and (led[0][:, 0], led[1])

    def _led(self, row: int, here: Comparison, motion: Displacement | None) -> tuple[Array, Array] | None:
        """Where own motion leads from a place that agreed, and from GPS, meters from another one; see `Calibrated`."""
        kept = self._kept
        if kept and not self._calibrated:
            self._calibrated = _calibrated([one.comparison for one in kept], self._drift)
        shown = self._calibrated[row] if kept else None
        led = None if motion is None or shown is None else shown.predicted(motion)
        return led and (led[0] + meters_from(here, kept[row].comparison)[:, None], led[1])


def _calibrated(agreed: Sequence[Comparison], drift: float) -> list[Calibrated | None]:
    """By the places that agreed, and GPS there, up to each of them."""
    lat_deg, lon_deg = np.array([(one.lat_deg, one.lon_deg) for one in agreed]).T
    places = east_north(lat_deg, lon_deg)
    at_m = np.stack([places, places + [offset_m(one) for one in agreed]], axis=2)
    sigma_m = np.array([(one.place_sigma_m or one.each_sigma_m, one.each_sigma_m) for one in agreed])
    known: list[int] = []
    motions: list[Displacement] = []
    shown: list[Calibrated | None] = []
    for row, one in enumerate(agreed):
        if one.motion is None:
            shown.append(None)
            continue
        known.append(row)
        motions.append(one.motion)
        shown.append(calibrated(motions, at_m[known] - places[row][:, None], sigma_m[known], drift))
    return shown
