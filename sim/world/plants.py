"""Procedural pictures with a see-through ground: trees, hedges, fences; and the ground itself."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8]
"""(H, W, 4) RGBA, row 0 at the top."""

TREE_KINDS = ("round", "conifer", "poplar", "birch", "autumn", "bare")
GROUND_COLORS = {
    "town": (0.50, 0.49, 0.47), "shops": (0.56, 0.50, 0.45), "suburb": (0.33, 0.44, 0.20),
    "wood": (0.26, 0.27, 0.15), "open": (0.50, 0.50, 0.24),
}  # fmt: skip


def tree_picture(rng: np.random.Generator, kind: str, *, snow: bool = False) -> Picture:
    """One tree, 64 wide and 128 high; with snow, leaf trees are bare and conifers white on top."""
    wide, high = 64, 96
    canvas = np.zeros((high, wide, 4), np.float32)
    bark = (0.75, 0.74, 0.70) if kind == "birch" else (0.28, 0.21, 0.15)
    cv2.line(canvas, (32, 95), (32, 45), (*bark, 1.0), 3 if kind != "birch" else 2)
    if kind == "bare" or (snow and kind != "conifer"):
        _branches(canvas, rng, (32.0, 62.0), -np.pi / 2, 17.0, (*bark, 1.0))
        if snow:
            canvas[..., :3] = np.where(canvas[..., 3:] > 0, 0.35 + 0.6 * canvas[..., :3], 0)
    else:
        _crown(canvas, rng, kind)
        if snow:
            canvas[..., :3] = np.where(rng.random((high, wide, 1)) < 0.55, 0.88, canvas[..., :3])
    # Drawn 96 high; the rasterizer takes powers of two only.
    rows = np.arange(128) * 192 // 128
    return _to_picture(np.repeat(canvas, 2, axis=0)[rows])


def _crown(canvas: NDArray[np.float32], rng: np.random.Generator, kind: str) -> None:
    """Leaves in clumps inside the outline of the kind, lighter toward the top."""
    color = {
        "round": (0.22, 0.38, 0.13), "conifer": (0.12, 0.25, 0.15), "poplar": (0.30, 0.42, 0.16),
        "birch": (0.42, 0.50, 0.20), "autumn": (0.62, 0.36, 0.12),
    }[kind]  # fmt: skip
    for _ in range(70):
        drop = rng.uniform(0, 1)
        half = {"conifer": 3 + 25 * drop, "poplar": 11.0}.get(kind, 29 * np.sqrt(max(0.03, 1 - (2 * drop - 1) ** 2)))
        x, y = 32 + rng.uniform(-half, half), 8 + drop * (74 if kind in ("conifer", "poplar") else 56)
        shade = rng.uniform(0.65, 1.0) * (1.25 - 0.5 * drop)
        cv2.circle(canvas, (int(x), int(y)), int(rng.integers(3, 7)), (*(c * shade for c in color), 1.0), -1)


def _branches(
    canvas: NDArray[np.float32],
    rng: np.random.Generator,
    start: tuple[float, float],
    angle: float,
    length: float,
    color: tuple[float, ...],
) -> None:
    """A limb and, from its end, two or three thinner ones."""
    end = (start[0] + length * np.cos(angle), start[1] + length * np.sin(angle))
    cv2.line(canvas, tuple(map(int, start)), tuple(map(int, end)), color, 2 if length > 10 else 1)
    if length > 5:
        for turn in rng.uniform(-0.8, 0.8, 3):
            _branches(canvas, rng, end, angle + turn, length * 0.72, color)


def strip_picture(rng: np.random.Generator, kind: str) -> Picture:
    """A stretch of hedge, picket, rail fence, bush, or the dark inside of a wood; 64 x 64."""
    canvas = np.zeros((64, 64, 4), np.float32)
    if kind in ("picket", "rail"):
        paint = (0.88, 0.88, 0.85, 1.0) if kind == "picket" else (0.42, 0.33, 0.24, 1.0)
        for x in range(0, 64, 8 if kind == "picket" else 32):
            canvas[4:, x : x + (5 if kind == "picket" else 4)] = paint
        for y in (14, 34, 50)[: 3 if kind == "rail" else 2]:
            canvas[y : y + 5] = paint
        return _to_picture(canvas)
    color, edge = {
        "hedge": ((0.18, 0.32, 0.12), 5), "bush": ((0.30, 0.36, 0.16), 30), "depth": ((0.13, 0.18, 0.09), 16),
    }[kind]  # fmt: skip
    top = cv2.resize(rng.uniform(0, edge, (1, 9)).astype(np.float32), (64, 1), interpolation=cv2.INTER_CUBIC)
    canvas[...] = (*color, 1.0)
    canvas[..., :3] *= rng.uniform(0.6, 1.25, (64, 64, 1))
    if kind == "depth":
        for x in rng.integers(0, 62, 10):
            canvas[:, x : x + 2, :3] = 0.6 * np.array((0.35, 0.28, 0.2))
    canvas[np.arange(64)[:, None] < top] = 0
    return _to_picture(canvas)


def ground_picture(rng: np.random.Generator, kind: str, *, snow: bool = False) -> Picture:
    """What lies beside the road in a district; 64 x 64, repeats."""
    color = np.array((0.90, 0.91, 0.94) if snow else GROUND_COLORS[kind], np.float32)
    canvas = np.ones((64, 64, 4), np.float32)
    canvas[..., :3] = color * rng.uniform(0.93 if snow else 0.8, 1.08, (64, 64, 1))
    if kind in ("town", "shops") and not snow:
        canvas[::16, :, :3] *= 0.75
        canvas[:, ::16, :3] *= 0.75
    return _to_picture(canvas)


def road_picture(rng: np.random.Generator, *, dashed: bool, snow: bool = False) -> Picture:
    """8 m of road, 8 m wide, 128 x 128: asphalt, edge lines, middle line; under snow only wheel tracks."""
    canvas = np.ones((128, 128, 4), np.float32)
    canvas[..., :3] = 0.30 + 0.04 * rng.standard_normal((128, 128, 1))
    for _ in range(3):
        x, y = rng.integers(20, 100, 2)
        canvas[y : y + rng.integers(6, 26), x : x + rng.integers(6, 26), :3] *= 0.85
    if snow:
        canvas[..., :3] = 0.85 + 0.04 * rng.standard_normal((128, 128, 1))
        for x in (22, 46, 82, 106):
            canvas[:, x - 4 : x + 5, :3] = 0.45 + 0.05 * rng.standard_normal((128, 9, 1))
    else:
        canvas[:, 4:6, :3] = canvas[:, 122:124, :3] = 0.8
        canvas[: 56 if dashed else 128, 63:65, :3] = 0.85
    return _to_picture(canvas)


def _to_picture(canvas: NDArray[np.float32]) -> Picture:
    """0..1 to bytes; see-through pixels take the mean color, so that filtering leaves no dark rim."""
    solid = canvas[..., 3] > 0.5
    if not solid.all():
        canvas[~solid, :3] = canvas[solid, :3].mean(axis=0)
    return (np.clip(canvas, 0, 1) * 255).astype(np.uint8)
