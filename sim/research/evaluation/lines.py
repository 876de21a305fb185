"""Along-track errors of believed sequence matches: by direction and light, by sharpness, and their correlation length.

The roads and drives of `sim.research.evaluation.belief`, all of the road mapped. The midpoint of each match that is
believed by the votes alone, less where the vehicle was at the mean of its frames, above 0 ahead of it. One offset of
the rig serves each direction: the median by day, of all roads.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edge.config import Config, RigConfig
from edge.descriptor.network import Network
from edge.localization.place_fix import sequence_midpoint
from edge.localization.sequence_match import STAYS, changing_sigma_m
from edge.reference_map import Route
from edge.sequence import Direction
from sim.research.evaluation.roads import (
    CALIBRATION,
    DEFAULT_SAMPLING,
    DIRECTIONS,
    HOME_LEFT_M,
    LIGHTS,
    SPACING_M,
    TOLERANCE_M,
    DriveDescriptors,
    Floats,
    driven,
    mapped,
    worlds,
)
from sim.world.scenario import LightName

SHARPNESS = (-np.inf, 0.05, 0.1, np.inf)
LAGS_M = (10, 20, 40, 80)
CLAIMED = (0.994, 1.960)
"""Standard deviations within which a normal error is in 68 and 95 %."""
FEWEST = 20
"""Matches from which on a deviation says something."""


@dataclass(frozen=True)
class SequenceErrors:
    """Meters (n,) of each frame's match ahead of the vehicle, and its sharpness; NaN where none is believed.

    sigma_m: one standard deviation of off_m, as the filter assumes it.
    """

    off_m: Floats
    sharpness: Floats
    sigma_m: Floats

    @property
    def right(self) -> NDArray[np.bool_]:
        """Which matches are of the right place."""
        return np.abs(self.off_m) <= TOLERANCE_M


def errors_of(road: DriveDescriptors, query: DriveDescriptors, way: Direction, rig: RigConfig) -> SequenceErrors:
    """Of each frame of a drive over a road, all of it mapped; rig: with the drive's lane, and no offset."""
    config = Config(rig=rig, sampling=DEFAULT_SAMPLING)
    length, sign = config.sequence_frames, 1 if way == "forward" else -1
    off_m, sharpness, sigma_m = np.full((3, len(query.raw)), np.nan)
    with mapped(road, "whole") as map_set:
        route = Route(map_set)
        for frame, (_, match) in enumerate(driven(map_set, query, config)):
            if match is None or not match.accepted or frame < length - 1:
                continue
            middle = sequence_midpoint(match, route, length)
            if middle is not None:
                was_m = query.route_m[frame - length + 1 : frame + 1].mean()
                off_m[frame], sharpness[frame] = sign * (middle.along_m - was_m), match.sharpness
                sigma_m[frame] = np.hypot(middle.sigma_m, np.hypot(1, STAYS) * changing_sigma_m(match, rig))
    return SequenceErrors(off_m, sharpness, sigma_m)


def rows(args: argparse.Namespace) -> Iterator[str]:
    """How far off along-track believed sequence matches are: by direction and light, and by direction in all."""
    rig = RigConfig(left_reverse_m=HOME_LEFT_M)
    found: dict[tuple[Direction, LightName, int], SequenceErrors] = {}
    for number, (road, drives) in enumerate(worlds(args.seeds, args.length, args.cache, Network.load(Path("grid")))):
        for way in DIRECTIONS:
            for light in (CALIBRATION, *LIGHTS[way]):
                found[way, light, number] = errors_of(road, drives[light, way], way, rig)
    heads = (
        "sequence matches; beyond 40 m | mean, of each road | sd on a road | 68 %, 95 % off | in the filter's 68, 95 %"
    )
    spans = f"below {SHARPNESS[1]:g}, to {SHARPNESS[2]:g}, above"
    lags = ", ".join(map(str, LAGS_M))
    yield f"| direction, light | {heads} | alike {lags} m apart | rms by sharpness: {spans} |"
    yield "|---|---|---|---|---|---|---|---|"
    for way in DIRECTIONS:
        by_day = [one.off_m for (of_way, light, _), one in found.items() if (of_way, light) == (way, CALIBRATION)]
        offset_m = float(np.nanmedian(np.concatenate(by_day)))
        of_way = {
            light: [
                replace(one, off_m=one.off_m - offset_m)
                for (direction, of_light, _), one in found.items()
                if (direction, of_light) == (way, light)
            ]
            for light in (CALIBRATION, *LIGHTS[way])
        }
        words = "the same way, opposite views" if way == "forward" else "home"
        for light, several in of_way.items():
            yield f"| {words}, {light} | {_cells(several)} |"
        yield f"| {words}, all | {_cells([one for several in of_way.values() for one in several])} |"


def _cells(several: list[SequenceErrors]) -> str:
    right = [np.where(one.right, one.off_m, np.nan) for one in several]
    joined, sharpness = np.concatenate(right), np.concatenate([one.sharpness for one in several])
    wrong = sum(int((~one.right & ~np.isnan(one.off_m)).sum()) for one in several)
    known = np.abs(joined[~np.isnan(joined)])
    means = ", ".join(f"{np.nanmean(one):.1f}" for one in right) if len(right) <= 4 else f"{np.nanmean(joined):.1f}"
    deviation_m = np.sqrt(np.mean([np.nanvar(one) for one in right]))
    within = ", ".join(f"{one:.1f}" for one in np.quantile(known, [0.68, 0.95]))
    share = np.abs(joined) / np.concatenate([one.sigma_m for one in several])
    held = ", ".join(f"{np.mean(share[~np.isnan(joined)] <= sigmas):.2f}" for sigmas in CLAIMED)
    alike = ", ".join(f"{alikeness(right, lag_m):.2f}" for lag_m in LAGS_M)
    by_sharpness = []
    for low, high in pairwise(SHARPNESS):
        chosen = joined[(sharpness > low) & (sharpness <= high) & ~np.isnan(joined)]
        by_sharpness.append(f"{np.sqrt(np.mean(np.square(chosen))):.1f}" if len(chosen) >= FEWEST else "-")
    spread = f"{deviation_m:.1f} m", f"{within} m"
    cells = [f"{len(known)}; {wrong}", means, *spread, held, alike, ", ".join(by_sharpness)]
    return " | ".join(cells)


def alikeness(drives: list[Floats], lag_m: float) -> float:
    """Correlation of errors (n,) so many meters apart, each less its drive's mean; NaN where unknown."""
    lag, pairs = round(lag_m / SPACING_M), []
    for off_m in drives:
        own = off_m - np.nanmean(off_m)
        pairs.append(np.stack([own[:-lag], own[lag:]]))
    both = np.concatenate(pairs, axis=1)
    one, other = both[:, ~np.isnan(both).any(axis=0)]
    return float((one @ other) / np.sqrt((one @ one) * (other @ other)))
