"""Procedural pictures of walls: one material per building, another layout for each of its faces.

As on real buildings, material and window frames are shared by all faces; windows, doors, shop fronts, signs,
murals, pipes and ivy are each face's own.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

Color = tuple[float, float, float]
Rect = tuple[float, float, float, float]
"""x0, z0, x1, z1 in meters from the lower left corner of a face."""

Pattern = Literal["brick", "render", "plank", "stone", "panel"]

MATERIALS: tuple[tuple[Pattern, Color], ...] = (
    ("brick", (0.55, 0.27, 0.20)), ("brick", (0.42, 0.22, 0.18)), ("brick", (0.66, 0.52, 0.34)),
    ("render", (0.88, 0.86, 0.80)), ("render", (0.85, 0.75, 0.50)), ("render", (0.62, 0.72, 0.78)),
    ("render", (0.80, 0.58, 0.50)), ("render", (0.55, 0.62, 0.50)), ("plank", (0.82, 0.84, 0.84)),
    ("plank", (0.40, 0.30, 0.22)), ("plank", (0.50, 0.60, 0.66)), ("stone", (0.58, 0.56, 0.52)),
    ("stone", (0.70, 0.64, 0.52)), ("panel", (0.50, 0.52, 0.56)), ("panel", (0.34, 0.36, 0.40)),
)  # fmt: skip
SIGN_COLORS: tuple[Color, ...] = (
    (0.75, 0.12, 0.12), (0.10, 0.25, 0.60), (0.08, 0.42, 0.22), (0.90, 0.70, 0.10), (0.15, 0.15, 0.17),
    (0.55, 0.15, 0.45), (0.90, 0.90, 0.88), (0.85, 0.40, 0.10),
)  # fmt: skip


@dataclass(frozen=True)
class WallStyle:
    """What all faces of one building share; lengths in meters."""

    pattern: Pattern
    color: Color
    frame: Color
    window_width_m: float
    window_height_m: float
    window_step_m: float
    story_m: float
    bars: int


def draw_style(rng: np.random.Generator, story_m: float = 2.9) -> WallStyle:
    """A style at random."""
    pattern, color = MATERIALS[rng.integers(len(MATERIALS))]
    shade = rng.uniform(0.85, 1.12)
    frame = ((0.92, 0.92, 0.9), (0.25, 0.2, 0.16), (0.2, 0.3, 0.25), (0.12, 0.12, 0.13))[rng.integers(4)]
    return WallStyle(
        pattern,
        (color[0] * shade, color[1] * shade, color[2] * shade),
        frame,
        window_width_m=rng.uniform(0.8, 1.9),
        window_height_m=rng.uniform(1.1, 1.8),
        window_step_m=rng.uniform(2.1, 3.4),
        story_m=story_m,
        bars=int(rng.integers(0, 3)),
    )


@dataclass
class Wall:
    """A face being painted: pixels (H, W, 3) float32 RGB in 0..1, row 0 at the top; size in meters."""

    pixels: NDArray[np.float32]
    width_m: float
    height_m: float
    rng: np.random.Generator
    windows: list[Rect] = field(default_factory=list)

    def fill(self, rect: Rect, color: Color | NDArray[np.float32]) -> None:
        """Paint a rectangle; what lies outside the face is cut off."""
        rows, columns = self._span(rect)
        self.pixels[rows, columns] = np.asarray(color, dtype=np.float32)

    def darken(self, rect: Rect, factor: float) -> None:
        """Multiply what is there: stains, shadows under sills."""
        rows, columns = self._span(rect)
        self.pixels[rows, columns] *= factor

    def _span(self, rect: Rect) -> tuple[slice, slice]:
        high, wide = self.pixels.shape[:2]
        x0, x1 = (round(min(max(x / self.width_m, 0.0), 1.0) * wide) for x in (rect[0], rect[2]))
        z0, z1 = (round((1 - min(max(z / self.height_m, 0.0), 1.0)) * high) for z in (rect[1], rect[3]))
        return slice(z1, max(z0, z1 + 1)), slice(x0, max(x1, x0 + 1))


def bare_wall(
    rng: np.random.Generator, style: WallStyle, width_m: float, height_m: float, size: tuple[int, int]
) -> Wall:
    """A wall of the style's material without openings; `size` is columns, rows in pixels."""
    wide, high = size
    z = (np.arange(high)[::-1, None] + 0.5) * height_m / high
    x = (np.arange(wide)[None, :] + 0.5) * width_m / wide
    pixels = np.ones((high, wide, 3), np.float32) * np.asarray(style.color, np.float32)
    joints = {
        "brick": (np.mod(z, 0.5) < 0.09) | (np.mod(x + 0.45 * (np.mod(z, 1.0) < 0.5), 0.9) < 0.09),
        "stone": (np.mod(z, 0.7) < 0.1) | (np.mod(x + 0.7 * (np.mod(z, 1.4) < 0.7), 1.4) < 0.1),
        "plank": np.mod(z, 0.35) < 0.1,
        "panel": (np.mod(z, 1.5) < 0.1) | (np.mod(x, 2.0) < 0.1),
        "render": np.zeros((high, wide), bool),
    }[style.pattern]
    pixels[np.broadcast_to(joints, (high, wide))] *= 0.86
    pixels *= 1 + 0.05 * rng.standard_normal((high, wide, 1), dtype=np.float32)
    stains = cv2.resize(rng.uniform(0.84, 1.08, (5, 6)).astype(np.float32), size, interpolation=cv2.INTER_CUBIC)
    pixels *= stains[..., None]
    return Wall(pixels, width_m, height_m, rng)


def add_window(wall: Wall, style: WallStyle, x: float, z: float, width_m: float, height_m: float) -> None:
    """A framed window whose lower left corner is at x, z; curtains or a dim room behind the glass."""
    wall.fill((x - 0.12, z - 0.12, x + width_m + 0.12, z + height_m + 0.12), style.frame)
    glass = wall.rng.uniform(0.10, 0.24)
    wall.fill((x, z, x + width_m, z + height_m), (glass * 0.9, glass, glass * 1.15))
    if wall.rng.random() < 0.4:
        curtain = wall.rng.uniform(0.45, 0.8, 3)
        share = wall.rng.uniform(0.15, 0.4)
        wall.fill((x, z, x + width_m * share, z + height_m), curtain.astype(np.float32))
        wall.fill((x + width_m * (1 - share), z, x + width_m, z + height_m), curtain.astype(np.float32))
    for bar in range(1, style.bars + 1):
        at = x + width_m * bar / (style.bars + 1)
        wall.fill((at - 0.03, z, at + 0.03, z + height_m), style.frame)
    wall.darken((x - 0.15, z - 0.35, x + width_m + 0.15, z - 0.12), 0.75)
    wall.windows.append((x, z, x + width_m, z + height_m))


def add_window_grid(wall: Wall, style: WallStyle, from_story: int, keep: float = 1.0) -> None:
    """Rows of windows from a story up; each is there with probability `keep`."""
    columns = max(1, int((wall.width_m - 0.8) / style.window_step_m))
    step_m = wall.width_m / columns
    for story in range(from_story, int((wall.height_m + 0.3) / style.story_m)):
        for column in range(columns):
            if wall.rng.random() < keep:
                x = (column + 0.5) * step_m - style.window_width_m / 2
                add_window(wall, style, x, story * style.story_m + 0.95, style.window_width_m, style.window_height_m)


def add_door(wall: Wall, x: float, width_m: float = 1.1, height_m: float = 2.2) -> None:
    """A door with a lintel, in a color of its own."""
    color = SIGN_COLORS[wall.rng.integers(len(SIGN_COLORS))]
    wall.fill((x - 0.15, 0, x + width_m + 0.15, height_m + 0.2), (0.8, 0.8, 0.78))
    wall.fill((x, 0, x + width_m, height_m), color)
    wall.darken((x + 0.2, 1.2, x + width_m - 0.2, height_m - 0.25), 0.55)


def add_garage(wall: Wall, x: float, width_m: float = 2.6) -> None:
    """A garage door with ribs."""
    shade = wall.rng.uniform(0.5, 0.9)
    wall.fill((x, 0, x + width_m, 2.2), (shade, shade, shade * 0.97))
    for z in np.arange(0.3, 2.2, 0.4):
        wall.darken((x, float(z), x + width_m, float(z) + 0.1), 0.75)


def add_sign(wall: Wall, rect: Rect) -> None:
    """A painted board with a row of strokes that stand for letters."""
    ground, ink = wall.rng.choice(len(SIGN_COLORS), 2, replace=False)
    wall.fill(rect, SIGN_COLORS[ground])
    x0, z0, x1, z1 = rect
    tall = z1 - z0
    x = x0 + 0.35 * tall
    end = x1 - 0.5 * tall - wall.rng.uniform(0, 0.3) * (x1 - x0)
    while x < end:
        wide = tall * wall.rng.uniform(0.15, 0.5)
        wall.fill((x, z0 + 0.2 * tall, min(x + wide, end), z1 - 0.2 * tall * wall.rng.uniform(1, 2)), SIGN_COLORS[ink])
        x += wide + 0.15 * tall


def add_shop_front(wall: Wall, style: WallStyle) -> None:
    """Ground floor of glass with goods behind it, a sign above, a door, and often an awning."""
    rng = wall.rng
    wall.fill((0, 0, wall.width_m, 2.9), SIGN_COLORS[rng.integers(len(SIGN_COLORS))])
    door = rng.uniform(0.3, wall.width_m - 1.6)
    for x0, x1 in ((0.35, door - 0.2), (door + 1.3, wall.width_m - 0.35)):
        if x1 - x0 > 0.8:
            wall.fill((x0, 0.5, x1, 2.4), (0.16, 0.18, 0.2))
            for x in np.arange(x0 + 0.2, x1 - 0.4, 0.6):
                top = rng.uniform(0.8, 2.0)
                wall.fill((float(x), 0.6, float(x) + 0.4, top), rng.uniform(0.2, 0.95, 3).astype(np.float32))
            wall.windows.append((x0, 0.5, x1, 2.4))
    add_door(wall, door, 1.1, 2.3)
    add_sign(wall, (0.15, 2.5, wall.width_m - 0.15, 3.3))
    if rng.random() < 0.5:
        stripes = [SIGN_COLORS[i] for i in rng.choice(len(SIGN_COLORS), 2, replace=False)]
        for i, x in enumerate(np.arange(0.2, wall.width_m - 0.2, 0.5)):
            wall.fill((float(x), 2.05, float(x) + 0.5, 2.55), stripes[i % 2])


def add_ivy(wall: Wall) -> None:
    """Climbing leaves over a part of the wall."""
    high, wide = wall.pixels.shape[:2]
    cover = cv2.resize(wall.rng.random((6, 8)).astype(np.float32), (wide, high), interpolation=cv2.INTER_CUBIC)
    cover = cover + np.linspace(-0.5, 0.25, high, dtype=np.float32)[:, None]
    leaves = wall.rng.uniform(0.5, 1.1, (high, wide, 1)).astype(np.float32) * np.array((0.2, 0.36, 0.14), np.float32)
    wall.pixels[cover > 0.45] = leaves[cover > 0.45]


def add_mural(wall: Wall) -> None:
    """A large advertisement: a ground, two or three shapes, a line of letters."""
    rng = wall.rng
    x0, x1 = 0.12 * wall.width_m, rng.uniform(0.7, 0.92) * wall.width_m
    z0, z1 = 0.3 * wall.height_m, 0.85 * wall.height_m
    wall.fill((x0, z0, x1, z1), SIGN_COLORS[rng.integers(len(SIGN_COLORS))])
    for _ in range(rng.integers(2, 4)):
        x, z = rng.uniform(x0, x0 + 0.6 * (x1 - x0)), rng.uniform(z0 + 0.2 * (z1 - z0), z0 + 0.7 * (z1 - z0))
        size = rng.uniform(0.15, 0.35)
        shape = (x, z, min(x + size * (x1 - x0), x1), min(z + size * (z1 - z0), z1))
        wall.fill(shape, SIGN_COLORS[rng.integers(len(SIGN_COLORS))])
    add_sign(wall, (x0, z0, x1, z0 + 0.2 * (z1 - z0)))
