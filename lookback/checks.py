"""What arguments may be: each check gives the argument as it is used, or raises a ValueError of one line."""

from __future__ import annotations

import operator
from collections.abc import Iterable
from typing import Any, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from edge.config import FieldOfView
from edge.feed import View

LONGEST = 500
"""Frames of a sequence, as in a plan of `lookback compare`."""


def descriptors(given: ArrayLike) -> NDArray[np.float32]:
    """Descriptors (N, R, D) or (N, D) as (N, R, D) float32."""
    raw = np.asarray(given)
    whole = raw[:, np.newaxis] if raw.ndim == 2 else raw
    if whole.ndim != 3 or whole.shape[1] not in (1, 2) or not whole.size or raw.dtype.kind != "f":
        raise ValueError(f"descriptors are (N, D) or (N, 1 or 2 regions, D), not {raw.shape} {raw.dtype}")
    if not (np.abs(whole) <= np.finfo(np.float32).max).all():
        raise ValueError("descriptors are finite numbers: one of these is NaN, infinite or too large for float32")
    return whole.astype(np.float32)


def same_kind(query: NDArray[np.float32], reference: NDArray[np.float32]) -> None:
    """Descriptors (Q, R, D) and (N, R, D)."""
    if query.shape[1:] != reference.shape[1:]:
        raise ValueError(f"query {query.shape} and reference {reference.shape} differ in regions or dimensions")


def similarities(given: ArrayLike) -> NDArray[np.floating]:
    """Similarities (Q, N) or (2, Q, N)."""
    found = np.asarray(given)
    is_whole = found.ndim == 2 or (found.ndim == 3 and len(found) == 2)
    if not is_whole or found.dtype.kind not in "fiu" or not found.size or not np.isfinite(found).all():
        raise ValueError(f"similarities are finite numbers (Q, N) or (2, Q, N), not {found.shape} {found.dtype}")
    return found


def flags(name: str, given: ArrayLike, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """True and False (Q, N), or 1 and 0."""
    found = np.asarray(given)
    if found.shape != shape or found.dtype.kind not in "biuf" or not np.isin(found, (0, 1)).all():
        raise ValueError(
            f"{name} is True or False, or 1 or 0, {shape} (queries, places), not {found.dtype} {found.shape}"
        )
    return found.astype(np.bool_)


def count(name: str, given: int, most: int, least: int = 1) -> int:
    """A whole number from `least` to `most`."""
    try:
        found = operator.index(given)
    except TypeError:
        found = least - 1
    if not least <= found <= most:
        raise ValueError(f"{name} is a whole number from {least} to {most}, not {given!r}")
    return found


def number(name: str, given: float, least: float = -np.inf, most: float = np.inf) -> float:
    """A finite number from `least` to `most`."""
    try:
        found = np.nan if isinstance(given, (str, bytes)) else float(given)
    except (TypeError, ValueError):
        found = np.nan
    if not (np.isfinite(found) and least <= found <= most):
        limits = (
            f" from {least:g} to {most:g}" if most < np.inf else f" of at least {least:g}" if least > -np.inf else ""
        )
        raise ValueError(f"{name} is a number{limits}, not {given!r}")
    return found


def field_of_view(given: float) -> float:
    """Horizontal, in degrees."""
    limits = get_args(FieldOfView)[1]
    return number("fov_deg", given, limits.ge, limits.le)


def views(given: Any) -> tuple[View, View]:
    """Where the cameras of reference and query face."""
    known, found = get_args(View), tuple(given) if isinstance(given, Iterable) else ()
    if len(found) != 2 or any(one not in known for one in found):
        raise ValueError(f"views are two of {', '.join(map(repr, known))}: of reference and query; not {given!r}")
    return found[0], found[1]


def meters(name: str, given: ArrayLike, rows: int) -> NDArray[np.float64]:
    """Meters driven (rows,), never falling."""
    found = np.asarray(given, dtype=np.float64)
    if found.shape != (rows,) or not np.isfinite(found).all() or (np.diff(found) < 0).any():
        raise ValueError(f"{name} is meters driven, never falling, one for each of {rows} rows; not {found.shape}")
    return found
