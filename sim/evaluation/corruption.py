"""Pictures as a camera gives them in bad weather, at night, or through a dirty lens: corruptions of severity 1 to 5.

Those of ImageNet-C (Hendrycks and Dietterich, 2019) have its parameters, for a picture of which the shorter side has
SIDE_PX pixels; `frost` is drawn, and no photograph. `dark`, `rain`, `sun`, `water`, `mud` and `reflection` have their
own. What is on the lens is the same in each picture of a drive.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from edge.errors import ConfigError
from edge.feed import Feed, FeedImages

Picture: TypeAlias = Any
"""An array (H, W, 3) BGR, 0 to 1; or of all colors alike, (H, W)."""
SIDE_PX = 224
ON_LENS = {"frost", "mud", "reflection", "sun", "water"}
MUD = np.array([20, 42, 63]) / 255


def _clouds(image: Picture, rng: np.random.Generator, decay: float, coarsest: int = 1) -> Picture:
    """Fractal noise (H, W, 1), 0 to 1: each octave is `decay` times weaker than the next coarser one."""
    total = np.zeros(image.shape[:2])
    for octave in range(coarsest, 7):
        grid = rng.random((2**octave + 1, 2**octave + 1))
        total += decay ** (coarsest - octave) * cv2.resize(grid, image.shape[1::-1], interpolation=cv2.INTER_CUBIC)
    return ((total - total.min()) / np.ptp(total))[..., np.newaxis]


def _smeared(image: Picture, length: float, sigma: float, angle: float) -> Picture:
    """In one direction, less the further away."""
    scale = min(image.shape[:2]) / SIDE_PX
    reach = math.ceil(length * scale)
    kernel = np.zeros((2 * reach + 1, 2 * reach + 1), np.float32)
    for step in np.arange(0, reach, 0.5):
        at = round(reach + step * math.sin(angle)), round(reach + step * math.cos(angle))
        kernel[at] += math.exp(-((step / (sigma * scale)) ** 2) / 2)
    return cv2.filter2D(image, -1, kernel / kernel.sum())


def _shaken(image: Picture, rng: np.random.Generator, length: float, sigma: float) -> Picture:
    return _smeared(image, length, sigma, rng.uniform(-1, 1) * math.pi / 4)


def _blurred(image: Picture, radius: float) -> Picture:
    radius_px = radius * min(image.shape[:2]) / SIDE_PX
    disk = np.hypot(*np.indices([2 * math.ceil(radius_px) + 1] * 2) - math.ceil(radius_px)) <= radius_px
    return cv2.filter2D(image, -1, disk / disk.sum())


def _covered(image: Picture, by: Picture, rng: np.random.Generator, share: float) -> Picture:
    """With blots of something else on that share of it."""
    clouds = _clouds(image, rng, 1.4, 3)
    blots = np.clip((clouds - np.quantile(clouds, 1 - share)) * 20, 0, 1)
    return image * (1 - blots) + by * blots


def _dark(image: Picture, rng: np.random.Generator, light: float) -> Picture:
    """1,000 electrons are white, read with a noise of 5."""
    return rng.poisson(image * light * 1e3) / 1e3 + rng.normal(0, 5e-3, image.shape)


def _rain(image: Picture, rng: np.random.Generator, share: float, length: float, veil: float) -> Picture:
    falls = _smeared(
        (rng.random(image.shape[:2]) < share).astype(np.float32), length, length, math.pi / 2 + rng.uniform(-0.15, 0.15)
    )
    return image * (1 - veil) + 0.6 * veil + (falls * length / 3)[..., np.newaxis]


def _wet(image: Picture, rng: np.random.Generator, share: float) -> Picture:
    """Drops show what is elsewhere, upside down and out of focus."""
    return _covered(image, _blurred(image[::-1, ::-1], 4), rng, share)


def _reflecting(image: Picture, rng: np.random.Generator, light: float) -> Picture:
    return _covered(image, image + light * _clouds(image, rng, 1.5, 3), rng, 0.3)


def _snow(image: Picture, rng: np.random.Generator, *of: float) -> Picture:
    mean, spread, zoom, least, length, sigma, clear = of
    flakes = rng.normal(mean, spread, [math.ceil(side / zoom) for side in image.shape[:2]])
    layer = cv2.resize(flakes, image.shape[1::-1], interpolation=cv2.INTER_LINEAR)
    layer = _smeared(np.where(layer < least, 0, layer).clip(0, 1), length, sigma, rng.uniform(0.25, 0.75) * math.pi)
    gray = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)[..., np.newaxis] * 1.5 + 0.5
    return clear * image + (1 - clear) * np.maximum(image, gray) + (layer + layer[::-1, ::-1])[..., np.newaxis]


def _fog(image: Picture, rng: np.random.Generator, thick: float, decay: float) -> Picture:
    return (image + thick * _clouds(image, rng, decay)) * image.max() / (image.max() + thick)


def _frost(image: Picture, rng: np.random.Generator, clear: float, ice: float) -> Picture:
    return clear * image + ice * _clouds(image, rng, 1.1, 4) * _clouds(image, rng, 2.0) ** 0.5


def _jpeg(image: Picture, _: np.random.Generator, quality: int) -> Picture:
    encoded = cv2.imencode(".jpg", (image * 255).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return np.float32(1 / 255) * np.asarray(cv2.imdecode(encoded, cv2.IMREAD_COLOR))


def _sun(image: Picture, _: np.random.Generator, glare: float) -> Picture:
    y, x = np.indices(image.shape[:2]) / image.shape[0]
    away = np.hypot(x - 0.6 * image.shape[1] / image.shape[0], y - 0.3)[..., np.newaxis]
    return image + glare * (np.exp(-away / 0.3) + (away < 0.1))


LIGHT_SNOW = (0.1, 0.3, 3, 0.5, 10, 4, 0.8), (0.2, 0.3, 2, 0.5, 12, 4, 0.7)
SNOW = (0.55, 0.3, 4, 0.9, 12, 8, 0.7), (0.55, 0.3, 4.5, 0.85, 12, 8, 0.65), (0.55, 0.3, 2.5, 0.85, 12, 12, 0.55)
RAIN = ((0.002, 8, 0.1), (0.004, 10, 0.15), (0.006, 12, 0.2), (0.01, 14, 0.3), (0.015, 16, 0.4))
KINDS: dict[str, tuple[Callable[..., Picture], tuple[Any, ...]]] = {
    "noise": (lambda image, rng, c: image + rng.normal(0, c, image.shape), (0.08, 0.12, 0.18, 0.26, 0.38)),
    "shot": (lambda image, rng, c: rng.poisson(image * c) / c, (60, 25, 12, 5, 3)),
    "dark": (_dark, (0.4, 0.2, 0.1, 0.05, 0.02)),
    "defocus": (lambda image, _, c: _blurred(image, c), (3, 4, 6, 8, 10)),
    "motion": (_shaken, ((10, 3), (15, 5), (15, 8), (15, 12), (20, 15))),
    "rain": (_rain, RAIN),
    "snow": (_snow, (*LIGHT_SNOW, *SNOW)),
    "fog": (_fog, ((1.5, 2), (2.0, 2), (2.5, 1.7), (2.5, 1.5), (3.0, 1.4))),
    "frost": (_frost, ((1, 0.4), (0.8, 0.6), (0.7, 0.7), (0.65, 0.7), (0.6, 0.75))),
    "sun": (_sun, (0.3, 0.6, 1.0, 1.5, 2.0)),
    "contrast": (lambda image, _, c: (image - image.mean()) * c + image.mean(), (0.4, 0.3, 0.2, 0.1, 0.05)),
    "jpeg": (_jpeg, (25, 18, 15, 10, 7)),
    "water": (_wet, (0.1, 0.2, 0.3, 0.45, 0.6)),
    "mud": (lambda image, rng, c: _covered(image, MUD, rng, c), (0.05, 0.1, 0.2, 0.3, 0.4)),
    "reflection": (_reflecting, (0.2, 0.4, 0.6, 0.8, 1.0)),
}
"""How a picture becomes worse, and by which parameters in each severity."""


@dataclass(frozen=True)
class Corruption:
    """One of KINDS in a severity of 1 to 5."""

    name: str
    severity: int

    @classmethod
    def parse(cls, words: str) -> Corruption:
        """Of NAME:SEVERITY. ConfigError."""
        name, _, severity = words.partition(":")
        if name not in KINDS or severity not in {"1", "2", "3", "4", "5"}:
            raise ConfigError(f"--corrupt {words}: it is NAME:SEVERITY, of {', '.join(KINDS)}, and 1 to 5")
        return cls(name, int(severity))

    def of(self, image: NDArray[np.uint8], index: int) -> NDArray[np.uint8]:
        """A picture (H, W, 3) uint8 BGR so corrupted; index: its number, from which it is drawn."""
        rng = np.random.default_rng(0 if self.name in ON_LENS else index)
        made, parameters = KINDS[self.name]
        found = made(image.astype(np.float32) / 255, rng, *np.atleast_1d(parameters[self.severity - 1]).tolist())
        return np.asarray((found * 255).round().clip(0, 255), np.uint8)

    def feed(self, feed: Feed) -> Feed:
        """A recording whose pictures are so corrupted."""
        name = f"{feed.header.name}, {self.name}:{self.severity}"
        header = msgspec.structs.replace(feed.header, name=name, video="")
        return replace(feed, header=header, pictures=lambda: _CorruptedImages(FeedImages(feed), self))


@dataclass(frozen=True)
class _CorruptedImages:
    images: FeedImages
    corruption: Corruption

    def read(self, index: int) -> NDArray[np.uint8]:
        return self.corruption.of(self.images.read(index), index)

    def close(self) -> None:
        self.images.close()
