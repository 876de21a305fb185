"""The motion of one picture, beside what the recognizer's network takes of it."""

from __future__ import annotations

import math
from itertools import count

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.config import CameraConfig, Config
from edge.descriptor.network import Network
from edge_plugins.motion import MotionConfig
from edge_plugins.motion.camera_motion import CameraMotion
from sim.bench.frames import SIZE_PX
from sim.bench.timing import race
from sim.research.bench.rows import Section, Target, against

FOV_DEG = 80.0
CONFIG = Config(camera=CameraConfig(fov_deg=FOV_DEG), plugins={"motion": MotionConfig(use="report")})
STEP_M, STEP_NS, HIGH_M, TEXEL_M = 0.7, 100_000_000, 1.4, 0.05
PICTURES, MOST_MS = 24, 3.0
ONE, NETWORK = "motion of one picture, 640x480", "network int8, batch 2"


def road(at_m: float) -> NDArray[np.uint8]:
    """A level road of random gray, (H, W, 3) BGR, as seen after `at_m`."""
    width, high = SIZE_PX
    texture = cv2.GaussianBlur(np.random.default_rng(5).integers(0, 255, (800, 400), np.uint8), (0, 0), 1.0)
    focal_px = width / 2 / math.tan(math.radians(FOV_DEG) / 2)
    camera = np.array([[focal_px, 0, width / 2], [0, focal_px, high / 2], [0, 0, 1]])
    ground = np.array([[1, 0, 0], [0, 0, HIGH_M], [0, 1, 0]])
    meters = np.array([[TEXEL_M, 0, -10], [0, TEXEL_M, -at_m], [0, 0, 1]])
    gray = cv2.warpPerspective(texture, camera @ ground @ meters, (width, high), borderValue=128)
    gray[: high // 2] = 128
    return cv2.cvtColor(gray, cv2.COLOR_GRAY2BGR).astype(np.uint8, copy=False)


def measure(rounds: int) -> Section:
    """A section of one row."""
    motion, number = CameraMotion(CONFIG), count(1)
    pictures = [road(STEP_M * step) for step in range(PICTURES)]
    network = Network.load()
    batch = np.zeros((2, *network.size, 3), np.uint8)

    def one() -> None:
        at = next(number)
        motion.follow(pictures[at % PICTURES], at * STEP_NS, None)

    times = race({ONE: one, NETWORK: lambda: network.describe(batch)}, 3 * rounds)
    took_ms = times[ONE].median_ms
    target = Target(ONE, f"{MOST_MS:g} ms or less", f"{took_ms:.2f} ms", took_ms <= MOST_MS)
    return Section("Motion by the camera", [against(ONE, ONE, times, NETWORK)], [target])
