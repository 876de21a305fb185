"""Compares the requested settings of a device with those it reports: drivers round or ignore requests."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TypeAlias

Setting: TypeAlias = str | int | float
FPS_TOLERANCE = 0.01  # 29.97 is what many drivers call 30


def differences(asked: Mapping[str, Setting], given: Mapping[str, Setting]) -> tuple[str, ...]:
    """One line for each setting in `given` that differs from the request: "fps: asked for 30, device gives 25"."""
    return tuple(
        f"{key}: asked for {_text(asked[key])}, device gives {_text(value)}"
        for key, value in given.items()
        if not _same(asked[key], value)
    )


def _same(asked: Setting, given: Setting) -> bool:
    if isinstance(asked, float) and isinstance(given, float):
        return math.isclose(asked, given, rel_tol=FPS_TOLERANCE)
    return asked == given


def _text(value: Setting) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
