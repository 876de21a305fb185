"""The stages of a frame after the camera, through the recognizer that the daemon runs."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from edge.config import Config, DescriptorConfig, MapConfig, RigConfig
from edge.descriptor.network import Network
from edge.recognition.recognizer import open_recognizer
from edge.reference_map import open_map_set
from edge.sequence import MotionPrior

SIZE_PX = (640, 480)
LENGTH = 40
"""Frames of a sequence, which warm up."""


def run_frames(
    map_path: Path, places: int, frames: int, network: Network, rig: RigConfig
) -> Iterator[dict[str, float]]:
    """CPU milliseconds of each stage of each frame of 640x480, after the warm-up, on a map with this many places."""
    milliseconds: dict[str, float] = {}
    last_ns = 0

    def lap(stage: str) -> None:
        """A stage has ended."""
        nonlocal last_ns
        now_ns = time.thread_time_ns()
        milliseconds[stage] = (now_ns - last_ns) / 1e6
        last_ns = now_ns

    descriptor = DescriptorConfig(model=str(network.path))
    config = Config(descriptor=descriptor, map=MapConfig(places_per_frame=max(100, places)), rig=rig)
    recognizer = open_recognizer(config, network=network, map_set=open_map_set(map_path), stopwatch=lap)
    rng = np.random.default_rng(1)
    for frame in range(LENGTH + frames):
        picture = smooth_picture(rng, SIZE_PX)
        milliseconds.clear()
        last_ns = time.thread_time_ns()
        recognizer.observe(picture, frame * 200_000_000, MotionPrior(frame * config.sampling.spacing_m))
        lap("answer")
        if frame >= LENGTH:
            yield dict(milliseconds)


def smooth_picture(rng: np.random.Generator, size: tuple[int, int]) -> np.ndarray:
    """A picture (H, W, 3) uint8 with something in it at every scale from 20 pixels up."""
    coarse = rng.integers(0, 255, (size[1] // 20, size[0] // 20, 3), dtype=np.uint8)
    return np.asarray(cv2.resize(coarse, size, interpolation=cv2.INTER_CUBIC), dtype=np.uint8)
