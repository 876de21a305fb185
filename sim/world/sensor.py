"""What lens and sensor add to a rendered picture: headlight beam, wet road, blur, drops or flakes, gain, noise."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from sim.world.light import Light

CAMERA_HIGH_M = 1.4
STREET_HALF_M = 7.5
WANTED_MEAN = 105.0


class Sensor:
    """One camera's imperfections in one condition. The same seed and time give the same picture.

    Beam and distance take the street for a corridor 2 x STREET_HALF_M wide, since the rasterizer keeps no depth.
    """

    def __init__(self, light: Light, view: str, size: tuple[int, int], fov_deg: float, seed: int) -> None:
        self._light = light
        self._seed = seed
        self._size = size
        wide, high = size
        rng = np.random.default_rng([seed, 6])
        self._plate = rng.standard_normal((2 * high, 2 * wide, 3), dtype=np.float32)
        self._phase = rng.uniform(0, 2 * np.pi, 2)
        x, y = np.meshgrid((np.arange(wide) + 0.5) / wide * 2 - 1, (np.arange(high) + 0.5) / high * 2 - 1)
        self._gain = (1 - 0.22 * (x**2 + y**2) / 2)[..., None] * np.array(light.gain[::-1])
        if light.headlight:
            self._gain *= 1 + light.headlight * _beam(size, fov_deg, front=view == "front")[..., None]
        self._gain = self._gain.astype(np.float32)

    def develop(self, image: NDArray[np.uint8], time_s: float) -> NDArray[np.uint8]:
        """The rendered picture (H, W, 3) uint8 BGR as the sensor gives it at a time of the drive."""
        light = self._light
        rng = np.random.default_rng([self._seed, round(time_s * 1e6) % 2**62])
        picture = image.astype(np.float32)
        if light.wet:
            _mirror_road(picture, light.wet)
        picture *= self._gain
        exposure = self._exposure(picture, time_s)
        picture *= exposure
        if light.streaks or light.flakes:
            self._precipitate(picture, rng)
        if light.blur_px:
            cv2.GaussianBlur(picture, (0, 0), light.blur_px * self._size[0] / 320, dst=picture)
        top, left = (int(rng.integers(n)) for n in self._size[::-1])
        picture += light.noise * exposure * self._plate[top : top + self._size[1], left : left + self._size[0]]
        return np.clip(picture, 0, 255).astype(np.uint8)

    def _exposure(self, picture: NDArray[np.float32], time_s: float) -> np.float32:
        """Automatic exposure: most of the way to the wanted mean, hunting a little over some 20 and 7 seconds."""
        wanted = np.clip((WANTED_MEAN / max(1.0, float(picture.mean()))) ** 0.7, 0.8, self._light.longest_exposure)
        drift = 0.05 * np.sin(time_s / 3.1 + self._phase[0]) + 0.03 * np.sin(time_s / 1.1 + self._phase[1])
        return np.float32(wanted * (1 + drift))

    def _precipitate(self, picture: NDArray[np.float32], rng: np.random.Generator) -> None:
        """Streaks of rain, or snowflakes: near ones are few, long and large."""
        wide, high = self._size
        layer = np.zeros((high, wide), np.float32)
        scale = wide / 320
        for x, y, near in rng.random((self._light.streaks + self._light.flakes, 3)):
            at = (int(x * wide), int(y * high))
            if self._light.streaks:
                end = (at[0] + int(2 * scale), at[1] + int((4 + 22 * near**3) * scale))
                cv2.line(layer, at, end, float(20 + 30 * near), 1)
            else:
                cv2.circle(layer, at, int((0.5 + 2.5 * near**6) * scale), float(40 + 60 * near), -1)
        picture += layer[..., None]


def _beam(size: tuple[int, int], fov_deg: float, *, front: bool) -> NDArray[np.float64]:
    """How much of the vehicle's light each pixel sees, (H, W): dipped headlights ahead, faint lamps behind."""
    wide, high = size
    focal = wide / 2 / np.tan(np.radians(fov_deg) / 2)
    x, y = np.meshgrid((np.arange(wide) + 0.5 - wide / 2) / focal, (np.arange(high) + 0.5 - high / 2) / focal)
    # Distance along the view to the ground, or to the walls of the corridor.
    reach = np.minimum(CAMERA_HIGH_M / np.maximum(y, 1e-3), STREET_HALF_M / np.maximum(np.abs(x), 1e-3))
    spread = np.exp(-((x / 0.55) ** 2)) / (1 + np.exp(np.clip(-(y + 0.03) / 0.03, -60, 60)))
    return np.asarray((1.0 if front else 0.15) * spread * 1.6 / (1 + (reach / 16) ** 2))


def _mirror_road(picture: NDArray[np.float32], share: float) -> None:
    """A wet road gives back part of what stands above the horizon."""
    half = picture.shape[0] // 2
    ramp = np.linspace(share, share * 0.4, picture.shape[0] - half, dtype=np.float32)[:, None, None]
    mirrored = cv2.blur(picture[:half][::-1], (5, 15))
    rows = min(half, picture.shape[0] - half)
    picture[half : half + rows] = (1 - ramp[:rows]) * picture[half : half + rows] + ramp[:rows] * mirrored[:rows]
