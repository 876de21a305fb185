"""The shapes that things are made of: textured four-cornered surfaces in meters east, north and up."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.world.plants import Picture
from sim.world.walls import Color, Rect, Wall

WHITE: Color = (1.0, 1.0, 1.0)
UNIT_UV = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], float)


@dataclass(frozen=True)
class Surface:
    """Four corners (4, 3), seen from the visible side: lower left, lower right, upper right, upper left.

    uv (4, 2): where the corners lie in the thing's picture, from its lower left; beyond 1 the picture repeats.
    """

    corners_m: NDArray[np.float64]
    uv: NDArray[np.float64]
    color: Color = WHITE


@dataclass(frozen=True)
class Thing:
    """Surfaces that share a picture. `snow` replaces the picture in snow; `windows` may be lit from inside.

    flat: a picture with a see-through ground, seen from both sides. upward: covered by snow when it snows.
    """

    picture: Picture
    surfaces: tuple[Surface, ...]
    windows: tuple[Surface, ...] = ()
    snow: Picture | None = None
    flat: bool = False
    upward: bool = False


@dataclass(frozen=True)
class Plot:
    """A place with axes of its own: x to the right along the street's side, y away from the street."""

    origin_m: tuple[float, float]
    x_axis: tuple[float, float]
    y_axis: tuple[float, float]

    def place(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Local x, y, z (..., 3) to east, north, up."""
        points = np.asarray(points, float)
        flat = points[..., :1] * np.array(self.x_axis) + points[..., 1:2] * np.array(self.y_axis) + self.origin_m
        return np.concatenate([flat, points[..., 2:]], axis=-1)


def plane(
    plot: Plot, start: tuple[float, float], end: tuple[float, float], z: tuple[float, float]
) -> NDArray[np.float64]:
    """Corners of an upright rectangle from local x, y `start` (left, as seen) to `end`."""
    (x0, y0), (x1, y1) = start, end
    return plot.place(np.array([(x0, y0, z[0]), (x1, y1, z[0]), (x1, y1, z[1]), (x0, y0, z[1])]))


def atlas(walls: list[Wall]) -> tuple[Picture, list[Rect]]:
    """The faces side by side in one picture, and the u0, v0, u1, v1 of each."""
    pixels = np.concatenate([wall.pixels for wall in walls], axis=1)
    picture = np.full((*pixels.shape[:2], 4), 255, np.uint8)
    picture[..., :3] = np.clip(pixels, 0, 1) * 255
    ends = np.cumsum([0, *(wall.pixels.shape[1] for wall in walls)]) / pixels.shape[1]
    return picture, [(float(a), 0.0, float(b), 1.0) for a, b in itertools.pairwise(ends)]


def rect_uv(rect: Rect) -> NDArray[np.float64]:
    """The four corners of a rectangle u0, v0, u1, v1."""
    u0, v0, u1, v1 = rect
    return np.array([(u0, v0), (u1, v0), (u1, v1), (u0, v1)])


def _sides(x0: float, y0: float, x1: float, y1: float) -> list[tuple[tuple[float, float], tuple[float, float]]]:
    """Start and end of the front, the end at x1, the back and the end at x0, as seen from outside."""
    corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
    return list(zip(corners, [*corners[1:], corners[0]], strict=True))


def house(plot: Plot, walls: list[Wall], *, base_m: float = 0.0) -> Thing:
    """Four upright walls: front, the end at x = width, back, the end at x = 0; sizes are those of the faces."""
    picture, rects = atlas(walls)
    sides = _sides(0.0, 0.0, walls[0].width_m, walls[1].width_m)
    surfaces, windows = [], []
    for wall, rect, (start, end) in zip(walls, rects, sides, strict=True):
        corners = plane(plot, start, end, (base_m, base_m + wall.height_m))
        surfaces.append(Surface(corners, rect_uv(rect)))
        windows += [_window(corners, rect, wall, window) for window in wall.windows]
    return Thing(picture, tuple(surfaces), tuple(windows))


def _window(corners: NDArray[np.float64], rect: Rect, wall: Wall, window: Rect) -> Surface:
    """The window of a wall as a surface 5 cm in front of it."""
    x0, z0, x1, z1 = (value / size for value, size in zip(window, (wall.width_m, wall.height_m) * 2, strict=True))
    along, up = corners[1] - corners[0], corners[3] - corners[0]
    out = np.cross(along, up)
    out *= 0.05 / np.linalg.norm(out)
    shares = rect_uv((x0, z0, x1, z1))
    uv = np.array((rect[0], rect[1])) + shares * (rect[2] - rect[0], rect[3] - rect[1])
    return Surface(corners[0] + out + shares[:, :1] * along + shares[:, 1:] * up, uv)


def pitched_roof(plot: Plot, size: tuple[float, float, float, float], picture: Picture, *, across: bool) -> Thing:
    """A roof over width, depth, from eaves height, by rise; the ridge along the street, or `across` it."""
    wide, deep, eaves, rise = size
    top, over = eaves + rise, 0.3
    if across:
        middle = wide / 2
        slopes = [
            [(-over, deep, eaves), (-over, -over, eaves), (middle, -over, top), (middle, deep, top)],
            [(wide + over, -over, eaves), (wide + over, deep, eaves), (middle, deep, top), (middle, -over, top)],
        ]
    else:
        middle = deep / 2
        slopes = [
            [(0, -over, eaves), (wide, -over, eaves), (wide, middle, top), (0, middle, top)],
            [(wide, deep + over, eaves), (0, deep + over, eaves), (0, middle, top), (wide, middle, top)],
        ]
    length = deep if across else wide
    uv = UNIT_UV * (length / 4, 1.0)
    return Thing(picture, tuple(Surface(plot.place(np.array(s)), uv) for s in slopes), upward=True)


def gable_ends(plot: Plot, size: tuple[float, float, float, float], picture: Picture, *, across: bool) -> Thing:
    """The triangles of wall under a pitched roof; `picture` is a bare piece of the same wall."""
    wide, deep, eaves, rise = size
    top = eaves + rise
    surfaces = []
    for (x0, y0), (x1, y1) in _sides(0.0, 0.0, wide, deep)[0 if across else 1 :: 2]:
        tip = ((x0 + x1) / 2, (y0 + y1) / 2, top)
        corners = plot.place(np.array([(x0, y0, eaves), (x1, y1, eaves), tip, tip]))
        surfaces.append(Surface(corners, np.array([(0, 0), (1, 0), (0.5, 1), (0.5, 1)], float)))
    return Thing(picture, tuple(surfaces))


def flat_top(plot: Plot, size: tuple[float, float, float], picture: Picture, color: Color = WHITE) -> Thing:
    """A level surface of width and depth at a height: flat roofs, sidewalks, fields."""
    wide, deep, high = size
    corners = plot.place(np.array([(0, 0, high), (wide, 0, high), (wide, deep, high), (0, deep, high)]))
    return Thing(picture, (Surface(corners, UNIT_UV * (wide / 4, deep / 4), color),), upward=True)


def crossed_planes(
    at_m: tuple[float, float], size_m: tuple[float, float], turn_rad: float, picture: Picture, snow: Picture
) -> Thing:
    """A tree: two upright pictures through each other, turned by an angle; size is width, height."""
    half, high = size_m[0] / 2, size_m[1]
    surfaces = []
    for angle in (turn_rad, turn_rad + np.pi / 2):
        axis = (float(np.cos(angle)), float(np.sin(angle)))
        plot = Plot(at_m, axis, (-axis[1], axis[0]))
        surfaces.append(Surface(plane(plot, (-half, 0), (half, 0), (0, high)), UNIT_UV))
    return Thing(picture, tuple(surfaces), snow=snow, flat=True)


def box(
    plot: Plot, low: tuple[float, float, float], high: tuple[float, float, float], picture: Picture, color: Color
) -> Thing:
    """An upright box of one color between two local corners: posts, chimneys, bins; no underside."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    surfaces = [Surface(plane(plot, *side, (z0, z1)), UNIT_UV, color) for side in _sides(x0, y0, x1, y1)]
    lid = plot.place(np.array([(x0, y0, z1), (x1, y0, z1), (x1, y1, z1), (x0, y1, z1)]))
    return Thing(picture, (*surfaces, Surface(lid, UNIT_UV, color)))
