"""The world of a seed: road, ground, and everything that stands along the route on every drive."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.world.districts import FILL
from sim.world.ground import SIDEWALK_M, lay_ground
from sim.world.lots import LotPictures
from sim.world.route import LEAD_M, DistrictKind, WorldRoute
from sim.world.sections import divide, plot_at
from sim.world.solids import Thing, box

LAMP_STEP_M: dict[DistrictKind, float] = {"town": 26.0, "shops": 22.0, "suburb": 38.0}
LAMP_HIGH_M = 6.0


@dataclass(frozen=True)
class World:
    """A route, what stands along it, and where its street lamps hang: lamps_m (N, 3) east, north, up."""

    route: WorldRoute
    things: tuple[Thing, ...]
    lamps_m: NDArray[np.float64]


def build_world(route: WorldRoute) -> World:
    """Everything that is the same on every drive; the route's seed alone decides it."""
    rng = np.random.default_rng([route.seed, 3])
    pictures = LotPictures(rng)
    things = list(lay_ground(route, rng))
    for side in (1, -1):
        for section in divide(route, rng, pictures, side):
            things += FILL[section.kind](section)
    lamps, masts = _lamps(route, pictures)
    return World(route, (*things, *masts), lamps)


def _lamps(route: WorldRoute, pictures: LotPictures) -> tuple[NDArray[np.float64], list[Thing]]:
    """Street lamps on alternate sides where people live: their lights (N, 3), and masts with an arm."""
    lights, masts, side = [], [], 1
    route_m = -LEAD_M + 5
    while route_m < route.length_m + LEAD_M:
        step_m = LAMP_STEP_M.get(route.district(route_m))
        if step_m:
            plot = plot_at(route, route_m, side, SIDEWALK_M - 0.4)
            lights.append(plot.place(np.array((0, -1.5, LAMP_HIGH_M))))
            mast = (-0.08, -0.08, 0.0), (0.08, 0.08, LAMP_HIGH_M + 0.1)
            arm = (-0.1, -1.7, LAMP_HIGH_M), (0.1, 0.0, LAMP_HIGH_M + 0.14)
            masts += [box(plot, *corners, pictures.plain, (0.4, 0.42, 0.42)) for corners in (mast, arm)]
            side = side if route.repeats_m else -side
        route_m += route.repeats_m or step_m or 20.0
    return np.array(lights).reshape(-1, 3), masts
