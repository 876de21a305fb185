"""The world of a seed: road, ground, and everything that stands along the route on every drive."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.world import lots
from sim.world.ground import PAVEMENT_M, lay_ground
from sim.world.lots import Pictures
from sim.world.route import LEAD_M, DistrictKind, Route
from sim.world.solids import Plot, Thing, box
from sim.world.walls import draw_style

LAMP_STEP_M: dict[DistrictKind, float] = {"town": 26.0, "shops": 22.0, "suburb": 38.0}
LAMP_HIGH_M = 6.0


@dataclass(frozen=True)
class World:
    """A route, what stands along it, and where its street lamps hang: lamps_m (N, 3) east, north, up."""

    route: Route
    things: tuple[Thing, ...]
    lamps_m: NDArray[np.float64]


def build_world(route: Route) -> World:
    """Everything that is the same on every drive; the route's seed alone decides it."""
    rng = np.random.default_rng([route.seed, 3])
    pictures = Pictures(rng)
    things = list(lay_ground(route, rng))
    for side in (1, -1):
        for start_m, kind, sub in _stretches(route, rng):
            things += _FILL[kind](sub, pictures, route, start_m, side)
    lamps, masts = _lamps(route, pictures)
    return World(route, (*things, *masts), lamps)


def plot_at(route: Route, route_m: float, side: int, away_m: float, width_m: float = 0.0) -> Plot:
    """A plot whose front is centred at `route_m`, `away_m` from the road's middle; side 1 is left, -1 right."""
    _, _, heading = route.at(route_m)
    forward = np.array((np.sin(heading), np.cos(heading)))
    left = np.array((-np.cos(heading), np.sin(heading)))
    east, north, _ = route.at(route_m, side * away_m)
    origin = np.array((east, north)) - side * forward * width_m / 2
    x_axis, y_axis = side * forward, side * left
    return Plot(
        (float(origin[0]), float(origin[1])), (float(x_axis[0]), float(x_axis[1])), (float(y_axis[0]), float(y_axis[1]))
    )


SECTION_M = 18.0


def _stretches(route: Route, rng: np.random.Generator) -> Iterator[tuple[float, DistrictKind, np.random.Generator]]:
    """Sections of SECTION_M with a generator each, over the whole route with its ends."""
    for start_m in np.arange(-LEAD_M + 5, route.length_m + LEAD_M - SECTION_M, SECTION_M):
        yield float(start_m), route.district(float(start_m) + SECTION_M / 2), np.random.default_rng(rng.integers(2**32))


def _clear(route: Route, plot: Plot, wide: float, deep: float) -> bool:
    """Whether a lot keeps off the road, also where the road bends around it."""
    corners = [(0, 0, 0), (wide / 2, 0, 0), (wide, 0, 0), (wide, deep, 0), (wide / 2, deep, 0), (0, deep, 0)]
    return route.clearance_m(plot.place(np.array(corners))[:, :2]) > PAVEMENT_M - 0.2


def _fill_town(
    rng: np.random.Generator, pictures: Pictures, route: Route, start_m: float, side: int, kind: str = "block"
) -> list[Thing]:
    """A row of two or three houses wall to wall, of one or several styles, with a gap after it at times."""
    things: list[Thing] = []
    away = PAVEMENT_M + (0.2 if kind == "shop" else rng.choice([0.3, 2.5, 4.5]))
    style = draw_style(rng, rng.uniform(2.7, 3.4))
    storeys = int(rng.integers(2, 4 if kind == "shop" else 6))
    built_m = SECTION_M - rng.choice([0.0, 3.0, 7.0], p=[0.35, 0.35, 0.3])
    count = int(rng.integers(1, 4))
    wide = built_m / count
    for i in range(count):
        if rng.random() < 0.5:
            style = draw_style(rng, style.storey_m)
        if rng.random() < 0.4:
            storeys = max(1, storeys + int(rng.integers(-1, 2)))
        plot = plot_at(route, start_m + (i + 0.5) * wide, side, away, wide)
        deep = rng.uniform(8, 12)
        if not _clear(route, plot, wide, deep):
            continue
        things += lots.building(rng, pictures, plot, style, (wide, deep, storeys), kind)
        if kind == "shop" and rng.random() < 0.5:
            things.append(lots.hanging_sign(rng, plot))
    if built_m < SECTION_M and rng.random() < 0.6:
        gap = plot_at(route, start_m + (built_m + SECTION_M) / 2, side, PAVEMENT_M + 4)
        things.append(lots.tree(rng, pictures, np.array(gap.origin_m), str(rng.choice(["round", "autumn"])), 6))
    return things


def _fill_shops(rng: np.random.Generator, pictures: Pictures, route: Route, start_m: float, side: int) -> list[Thing]:
    return _fill_town(rng, pictures, route, start_m, side, "shop")


def _fill_suburb(rng: np.random.Generator, pictures: Pictures, route: Route, start_m: float, side: int) -> list[Thing]:
    """One detached house in a garden behind a hedge or a fence, with a tree or two."""
    wide, deep = rng.uniform(8, 12), rng.uniform(7, 10)
    things: list[Thing] = []
    plot = plot_at(route, start_m + SECTION_M / 2, side, PAVEMENT_M + rng.uniform(3, 9), wide)
    if rng.random() < 0.88 and _clear(route, plot, wide, deep):
        style = draw_style(rng)
        things += lots.building(rng, pictures, plot, style, (wide, deep, int(rng.integers(1, 3))), "home")
    front = plot_at(route, start_m + SECTION_M / 2, side, PAVEMENT_M + 0.2, SECTION_M)
    edge = str(rng.choice(["hedge", "picket", "rail", "none"]))
    if edge != "none":
        high = rng.uniform(1.1, 2.2) if edge == "hedge" else 1.1
        drive_m = rng.uniform(3, 6)
        things.append(lots.strip(pictures, front, ((drive_m, 0), (SECTION_M, 0)), high, edge))
        things.append(lots.strip(pictures, front, ((SECTION_M, 0), (SECTION_M, 8)), high, edge))
    for _ in range(rng.integers(0, 3)):
        at = front.place(np.array((rng.uniform(0, SECTION_M), rng.uniform(1, 4), 0)))
        kind = str(rng.choice(["round", "birch", "conifer", "autumn", "bare"]))
        things.append(lots.tree(rng, pictures, at, kind, rng.uniform(4, 8)))
    return things


def _fill_wood(rng: np.random.Generator, pictures: Pictures, route: Route, start_m: float, side: int) -> list[Thing]:
    """Trees of one or two kinds, thick or thin, bushes, and the dark behind them."""
    front = plot_at(route, start_m + SECTION_M / 2, side, PAVEMENT_M, SECTION_M)
    kinds = rng.choice(["round", "conifer", "birch", "autumn", "poplar"], 2)
    high = rng.uniform(7, 14)
    things = [lots.strip(pictures, front, ((-1, 17), (SECTION_M + 1, 17)), rng.uniform(4, 8), "depth")]
    for _ in range(rng.integers(5, 15)):
        at = front.place(np.array((rng.uniform(0, SECTION_M), rng.uniform(0.5, 16), 0)))
        if route.clearance_m(at[None, :2]) > PAVEMENT_M - 1:
            things.append(lots.tree(rng, pictures, at, str(rng.choice(kinds)), high))
    if rng.random() < 0.6:
        x = rng.uniform(0, SECTION_M - 8)
        things.append(lots.strip(pictures, front, ((x, 1), (x + rng.uniform(4, 8), 3)), rng.uniform(0.8, 1.6), "bush"))
    return things


def _fill_open(rng: np.random.Generator, pictures: Pictures, route: Route, start_m: float, side: int) -> list[Thing]:
    """Fields: a fence or a hedge, poles, a lone tree, at times a barn or a billboard."""
    front = plot_at(route, start_m + SECTION_M / 2, side, PAVEMENT_M, SECTION_M)
    edge = str(rng.choice(["rail", "hedge", "bush", "none"]))
    things: list[Thing] = []
    if edge != "none":
        things.append(lots.strip(pictures, front, ((0, 0.5), (SECTION_M, 0.5)), rng.uniform(0.9, 1.6), edge))
    choice = rng.random()
    if choice < 0.15:
        plot = plot_at(route, start_m + SECTION_M / 2, side, PAVEMENT_M + rng.uniform(6, 16), 14)
        if _clear(route, plot, 20, 12):
            things += lots.barn(rng, pictures, plot, draw_style(rng))
    elif choice < 0.3:
        things += lots.billboard(rng, pictures, plot_at(route, start_m + SECTION_M / 2, side, PAVEMENT_M + 1))
    elif choice < 0.65:
        kind = str(rng.choice(["round", "poplar", "bare", "birch", "conifer"]))
        for _ in range(rng.integers(1, 5)):
            at = front.place(np.array((rng.uniform(0, SECTION_M), rng.uniform(1, 18), 0)))
            if route.clearance_m(at[None, :2]) > PAVEMENT_M - 0.5:
                things.append(lots.tree(rng, pictures, at, kind, rng.uniform(5, 11)))
    if rng.random() < 0.4:
        high = float(rng.choice([2.6, 8.0]))
        things += lots.post(rng, pictures, plot_at(route, start_m + 4, side, PAVEMENT_M - 0.7), high)
    return things


_FILL = {
    "town": _fill_town, "shops": _fill_shops, "suburb": _fill_suburb, "wood": _fill_wood, "open": _fill_open,
}  # fmt: skip


def _lamps(route: Route, pictures: Pictures) -> tuple[NDArray[np.float64], list[Thing]]:
    """Street lamps on alternate sides where people live: their lights (N, 3), and masts with an arm."""
    lights, masts, side = [], [], 1
    route_m = -LEAD_M + 5
    while route_m < route.length_m + LEAD_M:
        step_m = LAMP_STEP_M.get(route.district(route_m))
        if step_m:
            plot = plot_at(route, route_m, side, PAVEMENT_M - 1.3)
            lights.append(plot.place(np.array((0, -1.5, LAMP_HIGH_M))))
            masts.append(
                box(plot, (-0.08, -0.08, 0), (0.08, 0.08, LAMP_HIGH_M + 0.1), pictures.plain, (0.4, 0.42, 0.42))
            )
            masts.append(
                box(plot, (-0.1, -1.7, LAMP_HIGH_M), (0.1, 0, LAMP_HIGH_M + 0.14), pictures.plain, (0.4, 0.42, 0.42))
            )
            side = -side
        route_m += step_m or 20.0
    return np.array(lights).reshape(-1, 3), masts
