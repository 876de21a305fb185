"""The roadside cut into sections, a few of which make a block that was built, or grew, in one go."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from sim.world.ground import SIDEWALK_M
from sim.world.lots import LotPictures
from sim.world.plants import TREE_KINDS
from sim.world.route import LEAD_M, DistrictKind, WorldRoute
from sim.world.solids import Plot
from sim.world.walls import WallStyle, draw_style

SECTION_M = 18.0
SECTIONS_A_BLOCK = 3


@dataclass(frozen=True)
class Block:
    """What neighbors have in common: two house styles, stories, distance from the sidewalk, plants, how dense."""

    styles: tuple[WallStyle, WallStyle]
    stories: int
    setback: float
    trees: tuple[str, str]
    edge: str
    density: float
    high: float


@dataclass(frozen=True)
class RoadSection:
    """SECTION_M of one side of the road; side 1 is left, -1 right. Shares of a range (setback, high) are 0 to 1."""

    rng: np.random.Generator
    pictures: LotPictures
    route: WorldRoute
    block: Block
    kind: DistrictKind
    start_m: float
    side: int

    def plot(self, along_m: float, away_m: float, width_m: float = 0.0) -> Plot:
        """A plot centered `along_m` into the section, its front `away_m` from the road's middle."""
        return plot_at(self.route, self.start_m + along_m, self.side, away_m, width_m)

    def front(self) -> Plot:
        """The whole section from the sidewalk on."""
        return self.plot(SECTION_M / 2, SIDEWALK_M, SECTION_M)

    def is_clear(self, plot: Plot, wide: float, deep: float) -> bool:
        """Whether a lot keeps off the road, also where the road bends around it."""
        corners = [(0, 0, 0), (wide / 2, 0, 0), (wide, 0, 0), (wide, deep, 0), (wide / 2, deep, 0), (0, deep, 0)]
        return self.route.clearance_m(plot.place(np.array(corners))[:, :2]) > SIDEWALK_M - 0.2

    def style(self) -> WallStyle:
        """One of the block's styles, or at times one of its own."""
        return draw_style(self.rng) if self.rng.random() < 0.2 else self.block.styles[self.rng.integers(2)]

    def tree_kind(self) -> str:
        """One of the block's kinds, or at times any."""
        kinds = TREE_KINDS if self.rng.random() < 0.15 else self.block.trees
        return str(self.rng.choice(kinds))


def divide(route: WorldRoute, rng: np.random.Generator, pictures: LotPictures, side: int) -> Iterator[RoadSection]:
    """All sections of one side, over the whole route with its ends.

    Each has a generator of its own, or where houses repeat, that of those alike.
    """
    first_m, end_m = -LEAD_M + 5, route.length_m + LEAD_M - SECTION_M
    block = _draw_block(rng)
    if route.repeats_m:
        within_m = np.arange(0.0, max(route.repeats_m - SECTION_M, 0.0) + 0.01, SECTION_M)
        seeds, kind = rng.integers(2**32, size=len(within_m)), route.districts[0].kind
        for begin_m in np.arange(first_m, end_m, route.repeats_m):
            for seed, start_m in zip(seeds, begin_m + within_m, strict=True):
                yield RoadSection(np.random.default_rng(seed), pictures, route, block, kind, float(start_m), side)
        return
    starts = np.arange(first_m, end_m, SECTION_M)
    for number, start_m in enumerate(starts):
        if number % SECTIONS_A_BLOCK == 0:
            block = _draw_block(rng)
        own = np.random.default_rng(rng.integers(2**32))
        kind = route.district(float(start_m) + SECTION_M / 2)
        yield RoadSection(own, pictures, route, block, kind, float(start_m), side)


def _draw_block(rng: np.random.Generator) -> Block:
    return Block(
        styles=(draw_style(rng), draw_style(rng)),
        stories=int(rng.integers(1, 5)),
        setback=rng.uniform(),
        trees=(str(rng.choice(TREE_KINDS)), str(rng.choice(TREE_KINDS))),
        edge=str(rng.choice(["hedge", "picket", "rail", "none"])),
        density=rng.uniform(),
        high=rng.uniform(),
    )


def plot_at(route: WorldRoute, route_m: float, side: int, away_m: float, width_m: float = 0.0) -> Plot:
    """A plot whose front is centered at `route_m`, `away_m` from the road's middle; side 1 is left, -1 right."""
    _, _, heading = route.at(route_m)
    forward = np.array((np.sin(heading), np.cos(heading)))
    left = np.array((-np.cos(heading), np.sin(heading)))
    east, north, _ = route.at(route_m, side * away_m)
    origin = np.array((east, north)) - side * forward * width_m / 2
    x_axis, y_axis = side * forward, side * left
    return Plot(
        (float(origin[0]), float(origin[1])), (float(x_axis[0]), float(x_axis[1])), (float(y_axis[0]), float(y_axis[1]))
    )
