"""What each kind of district puts on a section of its roadside."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from sim.world import lots
from sim.world.ground import SIDEWALK_M
from sim.world.route import DistrictKind
from sim.world.sections import SECTION_M, RoadSection
from sim.world.solids import Thing


def fill_terrace(section: RoadSection, kind: str = "block") -> list[Thing]:
    """One to three houses wall to wall, with a gap after them at times."""
    rng, block = section.rng, section.block
    away = SIDEWALK_M + 0.3 + (0.0 if kind == "shop" else round(2 * block.setback) * 2.2)
    built_m = SECTION_M - rng.choice([0.0, 3.0, 7.0], p=[0.5, 0.25, 0.25])
    count = int(rng.integers(1, 4))
    wide = built_m / count
    things: list[Thing] = []
    for i in range(count):
        stories = max(1, block.stories + int(rng.choice([-1, 0, 1], p=[0.2, 0.6, 0.2])) - (kind == "shop"))
        plot = section.plot((i + 0.5) * wide, away, wide)
        deep = rng.uniform(8, 12)
        if section.is_clear(plot, wide, deep):
            things += lots.building(rng, section.pictures, plot, section.style(), (wide, deep, stories), kind)
            if kind == "shop" and rng.random() < 0.5:
                things.append(lots.hanging_sign(rng, plot))
    if built_m < SECTION_M and rng.random() < 0.6:
        at = np.array(section.plot((built_m + SECTION_M) / 2, SIDEWALK_M + 4).origin_m)
        things.append(lots.tree(rng, section.pictures, at, section.tree_kind(), 6))
    return things


def fill_shops(section: RoadSection) -> list[Thing]:
    """A terrace with shops on the ground floor, right at the sidewalk."""
    return fill_terrace(section, "shop")


def fill_suburb(section: RoadSection) -> list[Thing]:
    """One detached house in a garden behind a hedge or a fence, with a tree or two."""
    rng, block = section.rng, section.block
    wide, deep = rng.uniform(8, 12), rng.uniform(7, 10)
    things: list[Thing] = []
    plot = section.plot(SECTION_M / 2, SIDEWALK_M + 2 + 7 * block.setback + rng.uniform(0, 1.5), wide)
    if rng.random() < 0.88 and section.is_clear(plot, wide, deep):
        stories = 1 + (block.stories > 2)
        things += lots.building(rng, section.pictures, plot, section.style(), (wide, deep, stories), "home")
    front = section.front()
    if block.edge != "none":
        high = 1.1 + (1.1 * block.high if block.edge == "hedge" else 0.0)
        for span in (((rng.uniform(3, 6), 0.2), (SECTION_M, 0.2)), ((SECTION_M, 0.2), (SECTION_M, 8.0))):
            things.append(lots.strip(section.pictures, front, span, high, block.edge))
    for _ in range(rng.integers(0, 2 + round(3 * block.density))):
        at = front.place(np.array((rng.uniform(0, SECTION_M), rng.uniform(1, 4), 0)))
        things.append(lots.tree(rng, section.pictures, at, section.tree_kind(), 4 + 4 * block.high))
    return things


def fill_wood(section: RoadSection) -> list[Thing]:
    """Trees of mostly one or two kinds, thick or thin, bushes, and the dark behind them."""
    rng, block, front = section.rng, section.block, section.front()
    behind = ((-1.0, 17.0), (SECTION_M + 1, 17.0))
    things = [lots.strip(section.pictures, front, behind, 3 + 5 * block.high, "depth")]
    things += _grove(section, int(4 + 11 * block.density), (0.5, 16.0), 6 + 8 * block.high)
    if block.setback < 0.5:
        x = rng.uniform(0, SECTION_M - 8)
        span = ((x, 1.0), (x + rng.uniform(4, 8), 3.0))
        things.append(lots.strip(section.pictures, front, span, rng.uniform(0.8, 1.6), "bush"))
    return things


def fill_open(section: RoadSection) -> list[Thing]:
    """Fields: a fence or a hedge, poles, a few trees, at times a barn or a billboard."""
    rng, block, front = section.rng, section.block, section.front()
    things: list[Thing] = []
    if block.edge != "none":
        edge = "bush" if block.edge == "picket" else block.edge
        things.append(lots.strip(section.pictures, front, ((0, 0.5), (SECTION_M, 0.5)), 0.9 + 0.9 * block.high, edge))
    choice = rng.random()
    if choice < 0.15:
        plot = section.plot(SECTION_M / 2, SIDEWALK_M + rng.uniform(6, 16), 14)
        if section.is_clear(plot, 20, 12):
            things += lots.barn(rng, section.pictures, plot, section.style())
    elif choice < 0.3:
        things += lots.billboard(rng, section.pictures, section.plot(SECTION_M / 2, SIDEWALK_M + 1))
    elif block.density > 0.4:
        things += _grove(section, int(1 + 5 * block.density), (1.0, 18.0), 5 + 6 * block.high)
    if rng.random() < 0.2 or block.setback > 0.6:
        high = 8.0 if block.setback > 0.6 else 2.6
        things += lots.post(rng, section.pictures, section.plot(4, SIDEWALK_M - 0.7), high)
    return things


def _grove(section: RoadSection, count: int, away_m: tuple[float, float], high_m: float) -> list[Thing]:
    """Trees at random over the section, within distances from the sidewalk; none of them on the road."""
    rng, front = section.rng, section.front()
    trees = []
    for _ in range(count):
        at = front.place(np.array((rng.uniform(0, SECTION_M), rng.uniform(*away_m), 0)))
        if section.route.clearance_m(at[None, :2]) > SIDEWALK_M - 1:
            trees.append(lots.tree(rng, section.pictures, at, section.tree_kind(), high_m))
    return trees


FILL: Mapping[DistrictKind, Callable[[RoadSection], list[Thing]]] = {
    "town": fill_terrace,
    "shops": fill_shops,
    "suburb": fill_suburb,
    "wood": fill_wood,
    "open": fill_open,
}
