"""What a vehicle's wheels are worth, learned over its drives and kept beside the journal.

A drive counts for the radius that its autopilot had in `WHEEL_RADIUS` then. For another one, whoever has set it, what
it found is converted: wheels whose radius was corrected by it are right.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NamedTuple

import msgspec

from edge.files import PersistentFile
from edge.localization import MOST_DRIVES, OdometerCalibration, ScaleFactor, learned
from edge.telemetry.vehicle import Vehicle

LOST = "what earlier drives found of the wheels is lost"
PERIOD_NS = 10_000_000_000
"""How often what this drive has found is kept: what a power cut costs."""
WHEEL_RADIUS = "WENC_RADIUS"
"""Of ArduPilot, of its first wheel; those of the others are in proportion."""
log = logging.getLogger(__name__)


class KeptDrive(NamedTuple):
    """What a drive has found, see `ScaleFactor`, with wheels that counted as so large; 0: not known."""

    mean: float
    sigma: float
    radius_m: float = 0.0


class Wheels(msgspec.Struct, frozen=True):
    """The file: what the drives of each autopilot have found, the newest last."""

    drives: dict[int, list[KeptDrive]]


class WheelStore:
    """Gives a vehicle what its earlier drives have found of its wheels, and keeps what this drive finds.

    A drive is a run of this program with one radius. Its newest finding counts, of the last 500 m beside a GPS that
    nobody doubts.
    """

    def __init__(self, journal: str, vehicle: Vehicle, is_doubted: Callable[[], bool]) -> None:
        """journal: whose folder has the file; "" keeps nothing. is_doubted: whether places speak against GPS."""
        self._file = _file(journal)
        self._drives, self._before = _kept(journal), list[KeptDrive]()
        self._vehicle, self._is_doubted = vehicle, is_doubted
        self._of: tuple[int, float] | None = None  # system id and radius
        self.due_ns, self._was_changed = 0, False

    def keep(self, now_ns: int) -> None:
        """At `due_ns`, every ten seconds from when the radius is known."""
        vehicle, radius_m = self._vehicle, self._vehicle.session.parameters.get(WHEEL_RADIUS, 0.0)
        if vehicle.system_id is None or radius_m <= 0:
            return
        self.due_ns = now_ns + PERIOD_NS
        if (vehicle.system_id, radius_m) != self._of:
            if self._of is not None and self._of[0] == vehicle.system_id:
                vehicle.velocity.shown = OdometerCalibration()  # of meters that counted as others
            self._of, self._before = (vehicle.system_id, radius_m), self._drives.get(vehicle.system_id, [])
            scale = learned(_for_radius(self._before, radius_m))
            vehicle.velocity.shown.learn(scale)
            if scale is not None:
                log.info("wheels: %s, by %d drives", in_percent(scale), len(self._before))
        shown = vehicle.velocity.shown
        if shown.is_changed and not self._was_changed and shown.scale is not None and shown.learned is not None:
            log.warning("wheels: %s here, %s before: new tires?", in_percent(shown.scale), in_percent(shown.learned))
        self._was_changed = shown.is_changed
        if shown.found is None or self._is_doubted():
            return
        drives = [*self._before[1 - MOST_DRIVES :], KeptDrive(shown.found.mean, shown.found.sigma, radius_m)]
        if drives != self._drives.get(vehicle.system_id):
            self._drives = {**self._drives, vehicle.system_id: drives}
            self._file.write_behind(Wheels(self._drives))


def _file(journal: str) -> PersistentFile[Wheels]:
    return PersistentFile(Path(journal).with_suffix(".wheels") if journal else None, Wheels, LOST)


def _kept(journal: str) -> dict[int, list[KeptDrive]]:
    kept = _file(journal).read()
    return {} if kept is None else kept.drives


def _for_radius(drives: Iterable[KeptDrive], radius_m: float) -> list[ScaleFactor]:
    return [
        ScaleFactor((1 + mean) * was_m / radius_m - 1, sigma * was_m / radius_m)
        for mean, sigma, was_m in drives
        if was_m
    ]


def drives_of(journal: str, vehicle: Vehicle) -> list[ScaleFactor]:
    """What the drives of a vehicle have found, for the radius of its wheels now; none where that is not known."""
    radius_m = vehicle.session.parameters.get(WHEEL_RADIUS, 0.0)
    return _for_radius(_kept(journal).get(vehicle.system_id or 0, []), radius_m) if radius_m > 0 else []


def in_percent(scale: ScaleFactor) -> str:
    """By how much the wheels measure too little, with one standard deviation, for people."""
    return f"{100 * scale.mean:+.1f} % +- {100 * scale.later:.1f}"
