"""What stands on one lot beside the road: a house and its garden, a shop, a barn, a piece of wood.

Every function takes a generator and a `Plot` whose x runs along the lot's front and whose y leads away from the road.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim.world.plants import TREE_KINDS, Picture, strip_picture, tree_picture
from sim.world.solids import (
    UNIT_UV,
    Plot,
    Surface,
    Thing,
    atlas,
    box,
    crossed_planes,
    flat_top,
    gable_ends,
    house,
    pitched_roof,
    plane,
    rect_uv,
)
from sim.world.walls import (
    SIGN_COLORS,
    Wall,
    WallStyle,
    add_door,
    add_garage,
    add_ivy,
    add_mural,
    add_shop_front,
    add_sign,
    add_window,
    add_window_grid,
    bare_wall,
)

FACE_HIGH_PX = 128
FACE_WIDE_PX = (112, 56, 32, 56)  # front, end, back, end: 256 columns together

ROOFS = ((0.45, 0.22, 0.16), (0.30, 0.30, 0.33), (0.36, 0.27, 0.20), (0.24, 0.26, 0.24), (0.52, 0.36, 0.26))


class LotPictures:
    """Pictures that many things share: tree kinds, fences, tiles; a few variants of each."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.trees = {kind: [self._tree(rng, kind) for _ in range(2)] for kind in TREE_KINDS}
        self.strips = {kind: strip_picture(rng, kind) for kind in ("hedge", "picket", "rail", "bush", "depth")}
        self.tiles = [self._tile(rng, color) for color in ROOFS]
        self.plain: Picture = np.full((8, 8, 4), 255, np.uint8)

    @staticmethod
    def _tree(rng: np.random.Generator, kind: str) -> tuple[Picture, Picture]:
        """The same kind in leaf and under snow."""
        return tree_picture(rng, kind), tree_picture(rng, kind, snow=True)

    @staticmethod
    def _tile(rng: np.random.Generator, color: tuple[float, float, float]) -> Picture:
        pixels = np.ones((32, 32, 4), np.float32)
        pixels[..., :3] = np.array(color) * rng.uniform(0.85, 1.1, (32, 32, 1))
        pixels[::4, :, :3] *= 0.75
        return (np.clip(pixels, 0, 1) * 255).astype(np.uint8)


def tree(rng: np.random.Generator, pictures: LotPictures, at_m: NDArray[np.float64], kind: str, high_m: float) -> Thing:
    """A tree of a kind and about a height."""
    picture, snow = pictures.trees[kind][rng.integers(2)]
    high = high_m * rng.uniform(0.8, 1.25)
    # Spread against height: what grows leaves down to the ground must not reach into the lane.
    share = rng.uniform(0.35, 0.5) if kind in ("poplar", "conifer") else rng.uniform(0.6, 0.85)
    return crossed_planes((float(at_m[0]), float(at_m[1])), (share * high, high), rng.uniform(0, np.pi), picture, snow)


def strip(
    pictures: LotPictures, plot: Plot, span: tuple[tuple[float, float], tuple[float, float]], high_m: float, kind: str
) -> Thing:
    """A fence, hedge or thicket between two local points, seen from both sides."""
    (x0, y0), (x1, y1) = span
    repeats = max(1.0, round(np.hypot(x1 - x0, y1 - y0) / (2.5 * high_m)))
    surface = Surface(plane(plot, (x0, y0), (x1, y1), (0, high_m)), UNIT_UV * (repeats, 1.0))
    return Thing(pictures.strips[kind], (surface,), flat=True)


def building(
    rng: np.random.Generator,
    pictures: LotPictures,
    plot: Plot,
    style: WallStyle,
    size: tuple[float, float, int],
    kind: str,
) -> list[Thing]:
    """A house of width, depth and stories; kind is "home", "shop" or "block". Each face has a picture of its own."""
    wide, deep, stories = size
    high = stories * style.story_m + (0.9 if kind != "home" else 0.3)
    walls = _bare_walls(rng, style, wide, deep, high)
    _paint_front(walls[0], style, kind)
    add_window_grid(walls[2], style, 0, keep=0.6)
    for wall in (walls[1], walls[3]):
        _paint_end(wall, style, kind)
    things = [house(plot, walls)]
    tiles = pictures.tiles[rng.integers(len(pictures.tiles))]
    if kind != "home" and rng.random() < 0.65:
        return [*things, flat_top(plot, (wide, deep, high), pictures.plain, (0.35, 0.35, 0.36))]
    across = bool(rng.random() < 0.4)
    rise = (wide if across else deep) * rng.uniform(0.25, 0.5)
    bare, _ = atlas([bare_wall(rng, style, 6, 4, (32, 32))])
    things.append(pitched_roof(plot, (wide, deep, high, rise), tiles, across=across))
    things.append(gable_ends(plot, (wide, deep, high, rise), bare, across=across))
    if rng.random() < 0.7:
        x, y = rng.uniform(0.2, 0.7) * wide, rng.uniform(0.3, 0.6) * deep
        low, top = (x, y, high), (x + 0.8, y + 0.8, high + rise + 1.0)
        things.append(box(plot, low, top, pictures.plain, style.color))
    return things


def _bare_walls(rng: np.random.Generator, style: WallStyle, wide: float, deep: float, high: float) -> list[Wall]:
    """Of the four faces of a building, see `house`."""
    return [
        bare_wall(rng, style, width, high, (columns, FACE_HIGH_PX))
        for width, columns in zip((wide, deep, wide, deep), FACE_WIDE_PX, strict=True)
    ]


def _paint_front(wall: Wall, style: WallStyle, kind: str) -> None:
    """The face to the street."""
    rng = wall.rng
    if kind == "shop":
        add_window_grid(wall, style, 1)
        add_shop_front(wall, style)
        return
    add_window_grid(wall, style, 0)
    garage = kind == "home" and wall.width_m > 8.5 and rng.random() < 0.5
    if garage:
        wall.fill((wall.width_m - 3.6, 0, wall.width_m, 2.7), style.color)
        add_garage(wall, wall.width_m - 3.2)
    door = rng.uniform(0.6, wall.width_m * (0.5 if garage else 0.8) - 1.2)
    wall.fill((door - 0.5, 0, door + 1.6, 2.6), style.color)
    add_door(wall, door)
    if rng.random() < 0.15:
        add_ivy(wall)


def _paint_end(wall: Wall, style: WallStyle, kind: str) -> None:
    """An end wall: painted sign, ivy, a few windows, a garage or a side door, or nothing."""
    rng = wall.rng
    choice = rng.random()
    if kind != "home" and choice < 0.35:
        add_mural(wall)
    elif choice < 0.5:
        add_window_grid(wall, style, 0, keep=rng.uniform(0.4, 1.0))
    elif choice < 0.65:
        add_ivy(wall)
    elif choice < 0.8:
        x = rng.uniform(0.2, 0.6) * wall.width_m
        add_window(wall, style, x, wall.height_m - 1.9, 0.9, 1.1)
        add_door(wall, rng.uniform(0.1, 0.6) * wall.width_m)
    if rng.random() < 0.5:
        x = rng.uniform(0.05, 0.95) * wall.width_m
        wall.fill((x, 0, x + 0.15, wall.height_m), (0.25, 0.25, 0.26))


def hanging_sign(rng: np.random.Generator, plot: Plot) -> Thing:
    """A shop's board that stands out into the street: another picture on each side."""
    boards = [Wall(np.ones((32, 32, 3), np.float32), 1.4, 1.4, rng) for _ in range(2)]
    for board in boards:
        add_sign(board, (0, 0, 1.4, 1.4))
    picture, rects = atlas(boards)
    sides = [((0.0, -1.6), (0.0, -0.2)), ((0.0, -0.2), (0.0, -1.6))]
    surfaces = []
    for rect, (start, end) in zip(rects, sides, strict=True):
        surfaces.append(Surface(plane(plot, start, end, (3.2, 4.6)), rect_uv(rect)))
    return Thing(picture, tuple(surfaces))


def billboard(rng: np.random.Generator, pictures: LotPictures, plot: Plot) -> list[Thing]:
    """A large board across the view on two posts: one advertisement each way."""
    wide, high = rng.uniform(4, 7), rng.uniform(2.5, 3.5)
    boards = [Wall(np.full((64, 64, 3), 0.85, np.float32), wide, high, rng) for _ in range(2)]
    for board in boards:
        add_mural(board)
    picture, rects = atlas(boards)
    surfaces = []
    for rect, (y0, y1) in zip(rects, ((0.0, wide), (wide, 0.0)), strict=True):
        surfaces.append(Surface(plane(plot, (0, y0), (0, y1), (1.8, 1.8 + high)), rect_uv(rect)))
    posts = [box(plot, (-0.1, y, 0), (0.1, y + 0.2, 1.8), pictures.plain, (0.3, 0.25, 0.2)) for y in (0.5, wide - 0.7)]
    return [Thing(picture, tuple(surfaces)), *posts]


def barn(rng: np.random.Generator, pictures: LotPictures, plot: Plot, style: WallStyle) -> list[Thing]:
    """A farm building, far from the road, with a large door."""
    wide, deep, high = rng.uniform(10, 20), rng.uniform(8, 12), rng.uniform(3.5, 5.5)
    walls = _bare_walls(rng, style, wide, deep, high)
    add_garage(walls[int(rng.integers(2))], rng.uniform(1, 4), 3.4)
    add_window_grid(walls[1], style, 0, keep=0.5)
    tiles = pictures.tiles[rng.integers(len(pictures.tiles))]
    bare, _ = atlas([bare_wall(rng, style, 6, 4, (32, 32))])
    size = (wide, deep, high, deep * 0.35)
    roof = pitched_roof(plot, size, tiles, across=False)
    return [house(plot, walls), roof, gable_ends(plot, size, bare, across=False)]


def post(rng: np.random.Generator, pictures: LotPictures, plot: Plot, high_m: float) -> list[Thing]:
    """A wooden pole with a cross-arm, or a road sign of another color on its back."""
    pole = box(plot, (-0.1, -0.1, 0), (0.1, 0.1, high_m), pictures.plain, (0.33, 0.28, 0.22))
    if high_m > 5:
        low, high = (-0.08, -1.1, high_m - 0.9), (0.08, 1.1, high_m - 0.7)
        return [pole, box(plot, low, high, pictures.plain, (0.33, 0.28, 0.22))]
    color = SIGN_COLORS[rng.integers(len(SIGN_COLORS))]
    face = Surface(plane(plot, (-0.12, 0.45), (-0.12, -0.45), (high_m - 0.8, high_m)), UNIT_UV, color)
    back = Surface(plane(plot, (0.12, -0.45), (0.12, 0.45), (high_m - 0.8, high_m)), UNIT_UV, (0.6, 0.6, 0.6))
    return [pole, Thing(pictures.plain, (face, back))]
