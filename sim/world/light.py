"""Day, dusk, night, rain and snow: colors of the scene (0..1, RGB), and what they do to a sensor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Rgb = tuple[float, float, float]


@dataclass(frozen=True)
class Light:
    """One condition.

    sun_azimuth_deg, sun_elevation_deg: where the sun stands; sun and ambient: its light and the sky's.
    fog_per_m: how much of a thing's color turns into `fog` in each meter. lamps: strength of street lamps.
    lit_share: share of the windows that are lit. gain: the sensor's, by color.
    longest_exposure: how far automatic exposure may go up, against the day's. noise: standard deviation of a pixel (of
    255) before exposure. blur_px: of wet or cold glass. headlight: strength of the vehicle's own beam.
    streaks, flakes: how many drops or snowflakes a picture of 320 x 240 shows. wet: how much the road mirrors.
    """

    sun_azimuth_deg: float
    sun_elevation_deg: float
    sun: Rgb
    ambient: Rgb
    sky_top: Rgb
    sky_low: Rgb
    fog: Rgb
    fog_per_m: float
    clouds: float = 0.5
    lamps: float = 0.0
    lit_share: float = 0.0
    snow: bool = False
    gain: Rgb = (1.0, 1.0, 1.0)
    longest_exposure: float = 1.2
    noise: float = 2.0
    blur_px: float = 0.4
    headlight: float = 0.0
    streaks: int = 0
    flakes: int = 0
    wet: float = 0.0

    def sun_direction(self) -> NDArray[np.float64]:
        """Unit vector (3,) toward the sun: east, north, up."""
        azimuth, elevation = np.radians((self.sun_azimuth_deg, self.sun_elevation_deg))
        flat = np.cos(elevation)
        return np.array((flat * np.sin(azimuth), flat * np.cos(azimuth), np.sin(elevation)))


LIGHTS = {
    "day": Light(
        120, 50, sun=(0.62, 0.60, 0.54), ambient=(0.52, 0.54, 0.58), sky_top=(0.30, 0.50, 0.82),
        sky_low=(0.74, 0.83, 0.92), fog=(0.74, 0.80, 0.87), fog_per_m=0.0012,
    ),
    "dusk": Light(
        285, 8, sun=(0.42, 0.26, 0.14), ambient=(0.30, 0.29, 0.36), sky_top=(0.22, 0.26, 0.46),
        sky_low=(0.84, 0.56, 0.40), fog=(0.48, 0.40, 0.42), fog_per_m=0.003, clouds=0.8, lamps=0.5, lit_share=0.25,
        gain=(1.03, 0.95, 0.88), longest_exposure=1.7, noise=3.0, blur_px=0.5, headlight=0.15,
    ),
    "night": Light(
        200, 40, sun=(0.06, 0.07, 0.09), ambient=(0.28, 0.28, 0.32), sky_top=(0.16, 0.15, 0.17),
        sky_low=(0.50, 0.42, 0.38), fog=(0.09, 0.08, 0.09), fog_per_m=0.002, clouds=0.2, lamps=0.45, lit_share=0.2,
        gain=(1.0, 0.86, 0.66), longest_exposure=2.6, noise=3.5, blur_px=0.8, headlight=0.7,
    ),
    "rain": Light(
        180, 45, sun=(0.05, 0.05, 0.05), ambient=(0.50, 0.52, 0.55), sky_top=(0.42, 0.45, 0.49),
        sky_low=(0.58, 0.60, 0.62), fog=(0.52, 0.55, 0.58), fog_per_m=0.009, clouds=0.9, lit_share=0.2,
        gain=(0.84, 0.88, 0.92), noise=4.0, blur_px=0.9, headlight=0.1, streaks=90, wet=0.35,
    ),
    "snow": Light(
        180, 30, sun=(0.08, 0.08, 0.08), ambient=(0.82, 0.84, 0.88), sky_top=(0.70, 0.73, 0.78),
        sky_low=(0.82, 0.84, 0.87), fog=(0.83, 0.85, 0.88), fog_per_m=0.009, clouds=0.9, snow=True,
        gain=(0.98, 1.0, 1.04), noise=3.0, flakes=150,
    ),
}  # fmt: skip
"""By the name that a scenario gives as `light`."""


def illuminate(
    light: Light, points_m: NDArray[np.float64], normals: NDArray[np.float64], lamps_m: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Light that falls on surface points, (N, 3) RGB: sky, sun by the angle of the surface, and nearby lamps."""
    facing = np.clip(normals @ light.sun_direction(), 0, 1)[:, None]
    # The sky lights what faces up more than what faces down.
    sky = 0.85 + 0.15 * normals[:, 2:]
    shine = sky * np.array(light.ambient) + facing * np.array(light.sun)
    if light.lamps and len(lamps_m):
        for lamp in _near(lamps_m, points_m):
            to_lamp = lamp - points_m
            square = (to_lamp**2).sum(axis=1, keepdims=True)
            angle = np.clip((normals * to_lamp).sum(axis=1, keepdims=True) / np.sqrt(square), 0.15, 1)
            shine = shine + light.lamps * angle * 22 / (6 + square) * np.array((1.0, 0.78, 0.48))
    return np.asarray(shine)


def _near(lamps_m: NDArray[np.float64], points_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lamps within 40 m of the points' bounding box."""
    low, high = points_m.min(axis=0) - 40, points_m.max(axis=0) + 40
    return np.asarray(lamps_m[((lamps_m > low) & (lamps_m < high)).all(axis=1)])
