"""Cars: a body and a cabin, with a front, a rear and sides of their own."""

from __future__ import annotations

import numpy as np

from sim.world.solids import Plot, Surface, Thing, atlas, house, rect_uv
from sim.world.walls import Color, Wall

PAINTS: tuple[Color, ...] = (
    (0.85, 0.85, 0.86), (0.12, 0.12, 0.13), (0.55, 0.56, 0.58), (0.60, 0.08, 0.08), (0.10, 0.18, 0.42),
    (0.20, 0.34, 0.26), (0.78, 0.70, 0.45),
)  # fmt: skip
CAR_WIDTH_M = 1.8
HEADLIGHT: Color = (1.0, 0.98, 0.9)
TAILLIGHT: Color = (0.8, 0.05, 0.05)


def draw_car(plot: Plot, rng: np.random.Generator) -> tuple[Thing, ...]:
    """Body and cabin at `plot`: x to the car's right, y forward, the origin in the middle on the ground.

    The lamps are the body's windows: what may glow.
    """
    paint = PAINTS[rng.integers(len(PAINTS))]
    length, roof = rng.uniform(3.8, 4.9), rng.choice((1.4, 1.5, 1.9), p=(0.5, 0.35, 0.15))
    half, hood = CAR_WIDTH_M / 2, 0.85
    rear, side, front = (_panel(rng, paint, size, hood) for size in (CAR_WIDTH_M, length, CAR_WIDTH_M))
    for wall, lamp in ((rear, TAILLIGHT), (front, HEADLIGHT)):
        for x in (0.12, CAR_WIDTH_M - 0.42):
            wall.fill((x, 0.5, x + 0.3, 0.68), lamp)
            wall.windows.append((x, 0.5, x + 0.3, 0.68))
        wall.fill((0.6, 0.35, 1.2, 0.47), (0.9, 0.9, 0.85))
    for x in (0.6, length - 1.25):
        side.fill((x, 0.0, x + 0.65, 0.55), (0.05, 0.05, 0.05))
    body = house(_moved(plot, -half, -length / 2), [rear, side, front, side], base_m=0.12)
    glass = [_panel(rng, paint, size, roof - 0.95) for size in (CAR_WIDTH_M - 0.2, 0.55 * length)]
    for wall in glass:
        wall.fill((0.12, 0.08, wall.width_m - 0.12, wall.height_m - 0.12), (0.10, 0.12, 0.14))
    cabin = house(_moved(plot, 0.1 - half, -0.42 * length), [glass[0], glass[1], glass[0], glass[1]], base_m=0.95)
    return body, cabin, _lids(plot, rng, paint, length, roof)


def _panel(rng: np.random.Generator, paint: Color, width_m: float, height_m: float) -> Wall:
    pixels = np.ones((16, 32, 3), np.float32) * np.asarray(paint, np.float32)
    pixels[-3:] *= 0.4
    return Wall(pixels, width_m, height_m, rng)


def _moved(plot: Plot, x: float, y: float) -> Plot:
    east, north, _ = plot.place(np.array([x, y, 0.0]))
    return Plot((float(east), float(north)), plot.x_axis, plot.y_axis)


def _lids(plot: Plot, rng: np.random.Generator, paint: Color, length: float, roof: float) -> Thing:
    """Bonnet, boot and roof, seen from above."""
    picture, (rect,) = atlas([_panel(rng, paint, 1, 1)])
    half = CAR_WIDTH_M / 2
    spans = [
        (-half, -length / 2, half, length / 2, 0.97),
        (0.1 - half, -0.42 * length, half - 0.1, 0.13 * length, roof),
    ]
    surfaces = tuple(
        Surface(plot.place(np.array([(x0, y0, z), (x1, y0, z), (x1, y1, z), (x0, y1, z)])), rect_uv(rect) * 0.5 + 0.4)
        for x0, y0, x1, y1, z in spans
    )
    return Thing(picture, surfaces, upward=True)
