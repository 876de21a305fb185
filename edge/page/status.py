"""What the live page shows: immutable records that the daemon's loop hands over, and the page's thread reads.

A `Snapshot` is made only when somebody looks. Arrays in it are never written again by whoever made them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray


class CameraStatus(msgspec.Struct, frozen=True):
    """state: running | lost | ended. reason: why it is lost, or the last bad frame. Counts are since the start."""

    state: str
    reason: str
    differences: tuple[str, ...]
    delivered: int
    overwritten: int
    bad: int
    reopened: int


class LinkStatus(msgspec.Struct, frozen=True):
    """state: closed | waiting | up. Degrees (WGS 84), heading clockwise from north; None where not known."""

    state: str
    connection: str
    emit: str
    lat_deg: float | None = None
    lon_deg: float | None = None
    heading_deg: float | None = None
    speed_mps: float | None = None
    gps_healthy: bool = False


class MatchStatus(msgspec.Struct, frozen=True):
    """The newest match, believed or not; see `edge.recognizer.PlaceMatch`.

    map, row: the name of the place's map, where there is a folder of them, and its row there.
    """

    place: int
    direction: str
    order: str
    slope: float
    distance: float
    uniqueness: float
    accepted: bool
    lat_deg: float | None
    lon_deg: float | None
    map: str | None = None
    row: int | None = None


class FrameSample(msgspec.Struct, frozen=True, array_like=True):
    """One used frame in the history: where the vehicle then was by its autopilot, else by a believed match.

    uniqueness is None while there was no match. event: it went out as a place, and fix_lat_deg, fix_lon_deg are where
    that put the vehicle, None where the map does not know.
    """

    stamp_ns: int
    state: str
    uniqueness: float | None
    place: int | None
    event: bool
    lat_deg: float | None
    lon_deg: float | None
    fix_lat_deg: float | None = None
    fix_lon_deg: float | None = None


class Status(msgspec.Struct, frozen=True):
    """Everything about the daemon that is words and numbers.

    stamp_ns: CLOCK_MONOTONIC of the snapshot; started_unix_s tells one run of the daemon from the next. fps: used
    frames a second over the recent ones. stages_ms: medians. history: oldest first.
    """

    stamp_ns: int
    started_unix_s: float
    version: str
    map_name: str
    model: str
    state: str
    why: str
    frame_stamp_ns: int | None
    frames_used: int
    events: int
    fps: float
    category: str
    uniqueness_min: float
    stages_ms: dict[str, float]
    journal_lost: int
    camera: CameraStatus
    link: LinkStatus
    match: MatchStatus | None
    history: tuple[FrameSample, ...]


@dataclass(frozen=True)
class Snapshot:
    """A status with its pictures.

    image: the newest used frame (H, W, 3) uint8 BGR. costs: its cost row (orders, n) of `places` (n,), the part of the
    map that is searched. window: cost rows (L, W) of the places from `window_start` on, oldest first, as the line of
    the newest match saw them; empty while there is none. Costs are in units of 1 / cost_one of a cosine distance.
    """

    status: Status
    image: NDArray[np.uint8] | None
    costs: NDArray[np.int32]
    places: NDArray[np.intp]
    window: NDArray[np.int32]
    window_start: int
    cost_one: int


@dataclass(frozen=True)
class MapView:
    """What the page shows of the map: its drives as lists of (latitude, longitude), empty where unknown.

    thumbnail: the small JPEG of a place (any thread may ask); b"" where there is none.
    """

    places: int
    drives: tuple[tuple[tuple[float, float], ...], ...]
    thumbnail: Callable[[int], bytes]
