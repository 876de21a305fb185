"""Which of the daemon's maps are used; published as it becomes known.

Maps that cannot be used are excluded when they are opened. Checksums are computed while no frame waits, and a map that
turns out to be damaged is excluded.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

from edge.files import BackgroundWorker
from edge.journal.records import MapExcluded, Record
from edge.reference_map import ExcludedMap, MapSet

CHECK_BYTES = 8 << 20  # a few milliseconds, and seconds on a bad card
WAITS_S = 1.0
"""How long the loop waits in all for checksums: a match on a map that is not checked by then counts only when it is."""


class MapVerification:
    """What is left to check of some maps, and what was found."""

    def __init__(self, maps: MapSet, record: Callable[[Record], object]) -> None:
        """record: `Journal.write`."""
        self._record = record
        for excluded in maps.excluded:
            self._publish_excluded(excluded)
        self.checksums = maps.checksum_schedule()
        self._behind, self._damaged, self._may_wait_s = BackgroundWorker(), dict[Path, str](), WAITS_S

    def check_next(self, maps: MapSet, first: Sequence[Path], *, waits: bool = False) -> MapSet | None:
        """Have a thread check a further piece, of the maps in `first` before others; the maps that are left if one of
        them is damaged.

        waits: for this piece, unless the disk was waited for too long already.
        """
        if not (self._damaged or self._behind.is_busy):
            self._behind.start(partial(self._check, first))
        if waits and self.may_wait:
            began_s = time.monotonic()
            self._behind.wait(self._may_wait_s)
            self._may_wait_s -= time.monotonic() - began_s
        damaged = self._damaged
        return self._without(maps, damaged) if damaged else None

    @property
    def may_wait(self) -> bool:
        """Whether `check_next` still waits for the disk."""
        return self._may_wait_s > 0

    def without_cut(self, maps: MapSet) -> MapSet:
        """The maps that are left without those whose file became shorter while in use. MapError where none is left."""
        return self._without(maps, maps.cut) if maps.cut else maps

    def _check(self, first: Sequence[Path]) -> None:
        self._damaged = self.checksums.step(CHECK_BYTES, first)

    def _without(self, maps: MapSet, damaged: Mapping[Path, str]) -> MapSet:
        self._damaged = {}
        maps = maps.without(damaged)
        for excluded in maps.excluded[-len(damaged) :]:
            self._publish_excluded(excluded)
        return maps

    def _publish_excluded(self, excluded: ExcludedMap) -> None:
        excluded.log()
        self._record(MapExcluded(excluded.name, excluded.why))
