"""The sky and the hills at its foot: one panorama around the camera."""

from __future__ import annotations

import cv2
import numpy as np

from sim.world.light import Light
from sim.world.plants import Picture

WIDE, HIGH = 1024, 128
HORIZON = 0.2
"""Share of the panorama's height that lies below the horizon."""


def sky_picture(light: Light, world_seed: int, drive_seed: int) -> Picture:
    """Panorama from north round by east; hills are the world's, clouds the drive's."""
    up = np.clip((np.linspace(1, 0, HIGH) - HORIZON) / (1 - HORIZON), 0, 1)[:, None, None]
    low, top = np.array(light.sky_low), np.array(light.sky_top)
    sky = low + (top - low) * up**0.6 * np.ones((1, WIDE, 1))
    sky = _add_clouds(sky, light, np.random.default_rng([drive_seed, 7]))
    if light.sun_elevation_deg < 20:
        # The glow where the sun goes down.
        apart = (np.linspace(0, 360, WIDE) - light.sun_azimuth_deg + 180) % 360 - 180
        glow = np.exp(-((apart / 45) ** 2))[None, :, None] * (1 - up) ** 2
        sky = sky + glow * np.array((0.35, 0.18, 0.02))
    hills = _hills(np.random.default_rng([world_seed, 8]))
    below = np.linspace(1, 0, HIGH)[:, None] < HORIZON + hills[None]
    sky[below] = 0.45 * np.array(light.fog) + 0.3 * np.array(light.ambient) * (1.6 if light.snow else 1.0)
    picture = np.full((HIGH, WIDE, 4), 255, np.uint8)
    picture[..., :3] = np.clip(sky, 0, 1) * 255
    return picture


def _add_clouds(sky: np.ndarray, light: Light, rng: np.random.Generator) -> np.ndarray:
    """Clouds of three sizes, as dense as the light has them."""
    field = np.zeros((HIGH, WIDE))
    for cells, weight in (((4, 12), 0.5), ((8, 40), 0.3), ((20, 110), 0.2)):
        coarse = rng.random(cells).astype(np.float32)
        coarse[:, -1] = coarse[:, 0]
        field += weight * cv2.resize(coarse, (WIDE, HIGH), interpolation=cv2.INTER_CUBIC)
    cover = np.clip((field - 0.75 + 0.4 * light.clouds) * 4, 0, 1)[..., None]
    color = np.clip(np.array(light.sky_low) * 1.05 + 0.06, 0, 1)
    return np.asarray(sky + 0.7 * cover * (color - sky))


def _hills(rng: np.random.Generator) -> np.ndarray:
    """Height of the skyline above the horizon for each column, as a share of the panorama."""
    angle = np.linspace(0, 2 * np.pi, WIDE)
    waves = sum(rng.uniform(0, 0.02) * np.sin(k * angle + rng.uniform(0, 6.3)) for k in range(1, 12))
    return np.clip(0.03 + np.asarray(waves), 0.0, 0.12)
