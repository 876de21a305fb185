"""What GPS says over a drive, honest or spoofed: by how many meters east and north it is wrong, at each moment."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
History: TypeAlias = Callable[[Array, Array, np.random.Generator], Array]
"""Offsets (N, 2), given seconds (N,) in equal steps and the true positions (N, 2), meters east and north."""

WANDER_M, WANDER_S, NOISE_M = 1.2, 60.0, 0.2
BURST_M, BURST_S, BURST_EVERY_S = 10.0, (3.0, 15.0), 45.0
OUTAGE_S, OUTAGE_EVERY_S = 2.0, 60.0
DRAG_MPS = (0.5, 1.0, 2.0, 5.0)
TURNS_DEG = {"along": 0.0, "behind": 180.0, "left": -90.0, "right": 90.0}


def usual(time_s: Array, rng: np.random.Generator) -> Array:
    """An honest receiver under an open sky: an error that wanders, and noise."""
    step_s = float(time_s[1] - time_s[0])
    kept = math.exp(-step_s / WANDER_S)
    steps = rng.normal(0.0, WANDER_M * math.sqrt(1 - kept**2), (len(time_s), 2))
    errors, error = np.empty_like(steps), rng.normal(0.0, WANDER_M, 2)
    for row, change in enumerate(steps):
        error = kept * error + change
        errors[row] = error
    return errors + rng.normal(0.0, NOISE_M, errors.shape)


def multipath(time_s: Array, true_m: Array, rng: np.random.Generator) -> Array:
    """Honest: bursts of 10 m in streets, and outages of 2 s, in which there is no position (NaN)."""
    errors, at_s = usual(time_s, rng), float(time_s[0])
    while (at_s := at_s + rng.exponential(BURST_EVERY_S)) < time_s[-1]:
        angle, end_s = rng.uniform(0.0, 2 * math.pi), at_s + rng.uniform(*BURST_S)
        errors[(time_s >= at_s) & (time_s < end_s)] += BURST_M * np.array([math.sin(angle), math.cos(angle)])
        at_s = end_s
    at_s = float(time_s[0])
    while (at_s := at_s + rng.exponential(OUTAGE_EVERY_S)) < time_s[-1]:
        errors[(time_s >= at_s) & (time_s < at_s + OUTAGE_S)] = math.nan
    return errors


def rtk(time_s: Array, true_m: Array, rng: np.random.Generator) -> Array:
    """Honest: two centimeters."""
    return rng.normal(0.0, 0.02, (len(time_s), 2))


def drag(rate_mps: float, way: str, start_s: float) -> History:
    """The position leaves the truth at a speed, in a direction against that of travel when it begins."""

    def history(time_s: Array, true_m: Array, rng: np.random.Generator) -> Array:
        off_m = rate_mps * np.maximum(0.0, time_s - start_s)
        return usual(time_s, rng) + off_m[:, None] * _direction(time_s, true_m, start_s, TURNS_DEG[way])

    return history


def jump(off_m: float, start_s: float) -> History:
    """Meaconing: from one moment on a constant offset to the left."""

    def history(time_s: Array, true_m: Array, rng: np.random.Generator) -> Array:
        return usual(time_s, rng) + np.where(time_s >= start_s, off_m, 0.0)[:, None] * _direction(
            time_s, true_m, start_s, TURNS_DEG["left"]
        )

    return history


def replay(delay_s: float, start_s: float) -> History:
    """Positions of the same drive, recorded some time before."""

    def history(time_s: Array, true_m: Array, rng: np.random.Generator) -> Array:
        earlier_m = np.column_stack([np.interp(time_s - delay_s, time_s, true_m[:, axis]) for axis in (0, 1)])
        return usual(time_s, rng) + np.where(time_s >= start_s, 1.0, 0.0)[:, None] * (earlier_m - true_m)

    return history


def jammed(seconds: float, then: History, start_s: float) -> History:
    """No position for some seconds, and a spoofed one after that."""

    def history(time_s: Array, true_m: Array, rng: np.random.Generator) -> Array:
        offsets = then(time_s, true_m, rng)
        offsets[(time_s >= start_s) & (time_s < start_s + seconds)] = math.nan
        return offsets

    return history


def _direction(time_s: Array, true_m: Array, start_s: float, turn_deg: float) -> Array:
    """Unit vector, east and north, of the direction of travel at a moment, turned clockwise."""
    row = int(np.searchsorted(time_s, start_s).clip(0, len(time_s) - 2))
    east_m, north_m = true_m[row + 1] - true_m[row]
    angle = math.atan2(east_m, north_m) + math.radians(turn_deg)
    return np.array([math.sin(angle), math.cos(angle)])
