"""Pictures of a level road, ray by ray: an obvious camera to hold the fast equations of edge_plugins.motion against."""

from __future__ import annotations

import math
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

FOV_DEG, WIDTH, HEIGHT = 80.0, 320, 240
TEXEL_M = 0.05
TEXTURE = cv2.GaussianBlur(np.random.default_rng(5).integers(0, 255, (1600, 400), np.uint8), (0, 0), 1.0)
"""80 m of road, 20 m wide."""


@lru_cache(64)
def picture(
    north_m: float,
    *,
    high_m: float = 1.4,
    east_m: float = 0.0,
    heading_rad: float = 0.0,
    pitch_rad: float = 0.0,
    noise: float = 2.0,
    light: float = 1.0,
    seed: int = 0,
) -> NDArray[np.uint8]:
    """What a camera sees there that looks down by pitch_rad, (HEIGHT, WIDTH, 3) BGR; the sky is gray."""
    focal_px = WIDTH / 2 / math.tan(math.radians(FOV_DEG) / 2)
    u, v = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    right, down = (u - WIDTH / 2) / focal_px, (v - HEIGHT / 2) / focal_px
    falls = down * math.cos(pitch_rad) + math.sin(pitch_rad)
    forward = (math.cos(pitch_rad) - down * math.sin(pitch_rad)) * high_m / np.maximum(falls, 1e-3)
    sideways = right * high_m / np.maximum(falls, 1e-3)
    x_m = east_m + forward * math.sin(heading_rad) + sideways * math.cos(heading_rad)
    y_m = north_m + forward * math.cos(heading_rad) - sideways * math.sin(heading_rad)
    columns, rows = (x_m + 10.0) / TEXEL_M, y_m / TEXEL_M
    road = cv2.remap(TEXTURE, columns.astype(np.float32), rows.astype(np.float32), cv2.INTER_LINEAR)
    gray = np.where(falls > 0.02, road, 128) * light
    gray = gray + noise * np.random.default_rng([seed, round(north_m * 1000)]).standard_normal(gray.shape)
    return np.repeat(np.clip(gray, 0, 255).astype(np.uint8)[..., None], 3, axis=2)
