"""What a vehicle's wheels are worth, learned over its drives and kept beside the journal."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

import msgspec

from edge.files import PersistentFile
from edge.localization import MOST_DRIVES, DriveScale, ScaleFactor, learned
from edge.telemetry.vehicle import Vehicle

LOST = "what earlier drives found of the wheels is lost"
PERIOD_NS = 10_000_000_000
"""How often what this drive has found is kept: what a power cut costs."""
log = logging.getLogger(__name__)


class Wheels(msgspec.Struct, frozen=True):
    """The file: what the drives of each autopilot have found, the newest last."""

    drives: dict[int, list[DriveScale]]


class WheelStore:
    """Gives a vehicle what its earlier drives have found of its wheels, and keeps what this drive finds.

    A drive is a run of this program. Its newest finding counts, of the last 500 m beside a GPS that nobody doubts.
    """

    def __init__(self, journal: str, vehicle: Vehicle, is_doubted: Callable[[], bool]) -> None:
        """journal: whose folder has the file; "" keeps nothing. is_doubted: whether places speak against GPS."""
        self._file, self._before = _file(journal), kept_drives(journal)
        self._vehicle, self._is_doubted = vehicle, is_doubted
        self._system_id: int | None = None
        self._kept: DriveScale | None = None
        self.due_ns, self._was_changed = 0, False

    def keep(self, now_ns: int) -> None:
        """At `due_ns`, every ten seconds from the first heartbeats on."""
        vehicle, shown = self._vehicle, self._vehicle.velocity.shown
        if vehicle.system_id is None:
            return
        self.due_ns = now_ns + PERIOD_NS
        before = self._before.get(vehicle.system_id, [])
        if vehicle.system_id != self._system_id:
            self._system_id, self._kept = vehicle.system_id, None
            scale = learned(before)
            shown.learn(scale)
            if scale is not None:
                log.info("wheels: %s, by %d drives", in_percent(scale), len(before))
        if shown.is_changed and not self._was_changed and shown.scale is not None and shown.learned is not None:
            log.warning("wheels: %s here, %s before: new tires?", in_percent(shown.scale), in_percent(shown.learned))
        self._was_changed = shown.is_changed
        found = shown.found
        if found is None or found == self._kept or self._is_doubted():
            return
        self._kept = found
        self._file.write_behind(Wheels({**self._before, vehicle.system_id: [*before[1 - MOST_DRIVES :], found]}))


def _file(journal: str) -> PersistentFile[Wheels]:
    return PersistentFile(Path(journal).with_suffix(".wheels") if journal else None, Wheels, LOST)


def kept_drives(journal: str) -> dict[int, list[DriveScale]]:
    """What the drives of each autopilot have found, by its system id; none where nothing is kept."""
    kept = _file(journal).read()
    return {} if kept is None else kept.drives


def in_percent(scale: ScaleFactor) -> str:
    """By how much the wheels measure too little, with one standard deviation, for people."""
    return f"{100 * scale.mean:+.1f} % +- {100 * scale.later:.1f}"
