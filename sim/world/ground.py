"""The road, its sidewalks and the ground beside it, following the center line."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from sim.world.plants import ground_picture, road_picture
from sim.world.route import KINDS, LEAD_M, WorldRoute
from sim.world.solids import UNIT_UV, Surface, Thing

ROAD_HALF_M = 4.5
SIDEWALK_M = 6.2
GROUND_M = 36.0
STEP_M = 4.0


def lay_ground(route: WorldRoute, rng: np.random.Generator) -> Iterator[Thing]:
    """One Thing a kind of surface; strips of STEP_M along the route."""
    starts = np.arange(-LEAD_M, route.length_m + LEAD_M - STEP_M, STEP_M)
    roads = [road_picture(rng, dashed=dashed) for dashed in (True, False)]
    snowy = road_picture(rng, dashed=True, snow=True)
    for dashed, picture in zip((True, False), roads, strict=True):
        rows = [s for s in starts if (route.district(s) in ("wood", "open", "shops")) == dashed]
        surfaces = [_strip(route, s, (ROAD_HALF_M, -ROAD_HALF_M), 0.0, (1.0, 8.0)) for s in rows]
        yield Thing(picture, tuple(surfaces), snow=snowy)
    for kind in KINDS:
        rows = [s for s in starts if route.district(s) == kind]
        edge_m = ROAD_HALF_M if kind in ("wood", "open") else SIDEWALK_M
        picture, white = ground_picture(rng, kind), ground_picture(rng, kind, snow=True)
        spans = ((GROUND_M, edge_m), (-edge_m, -GROUND_M))
        beside = [_strip(route, s, span, -0.08, (8.0, 4.0)) for s in rows for span in spans]
        yield Thing(picture, tuple(beside), snow=white)
        if edge_m == SIDEWALK_M:
            paved, spans = ground_picture(rng, "town"), ((SIDEWALK_M, ROAD_HALF_M), (-ROAD_HALF_M, -SIDEWALK_M))
            walks = [_strip(route, s, span, 0.1, (1.0, 4.0)) for s in rows for span in spans]
            yield Thing(paved, tuple(walks), snow=white)
    yield _far_plain(route, ground_picture(rng, "open"), ground_picture(rng, "open", snow=True))


def _strip(
    route: WorldRoute, start_m: float, span_m: tuple[float, float], high_m: float, repeat: tuple[float, float]
) -> Surface:
    """STEP_M of a strip between two distances left of the middle, as seen from above with the road running up.

    repeat: pictures across the strip, and meters of road for one picture.
    """
    (left, right), end_m = span_m, start_m + STEP_M
    ends = (start_m, left), (start_m, right), (end_m, right), (end_m, left)
    corners = [(*route.at(along_m, lateral_m)[:2], high_m) for along_m, lateral_m in ends]
    v0 = (start_m + LEAD_M) / repeat[1] % 1.0
    v1 = v0 + STEP_M / repeat[1]
    uv: NDArray[np.float64] = np.array([(0, v0), (repeat[0], v0), (repeat[0], v1), (0, v1)])
    return Surface(np.array(corners), uv)


def _far_plain(route: WorldRoute, picture: NDArray[np.uint8], snow: NDArray[np.uint8]) -> Thing:
    """Level land out to the horizon, a little lower, in tiles of 60 m."""
    low, high = route.points_m.min(axis=0) - 300, route.points_m.max(axis=0) + 300
    tiles = []
    for east in np.arange(low[0], high[0], 60.0):
        for north in np.arange(low[1], high[1], 60.0):
            corners = [(east, north), (east + 60, north), (east + 60, north + 60), (east, north + 60)]
            tiles.append(Surface(np.array([(*corner, -0.25) for corner in corners]), 8 * UNIT_UV))
    return Thing(picture, tuple(tiles), snow=snow)
