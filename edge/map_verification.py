"""Which of the daemon's maps are used, and how far their positions are trusted; published as it becomes known.

Maps that cannot be used are excluded when they are opened. Checksums are computed while no frame waits, and a map that
turns out to be damaged is excluded. Drives that disagree about where a road is count as that uncertain.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from pathlib import Path

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.journal.records import DrivesDisagree, MapExcluded, Record
from edge.map_agreement import AT_START, as_uncertain, disagreements
from edge.reference_map import ExcludedMap, MapSet

CHECK_BYTES = 8 << 20  # a few milliseconds
log = logging.getLogger(__name__)


class MapVerification:
    """What is left to check of some maps, and what was found."""

    def __init__(
        self, maps: MapSet, record: Callable[[Record], object], status_text: Callable[[str, int], object]
    ) -> None:
        """Compare the drives. record: `Journal.write`. status_text: a line for the pilot, and its severity."""
        self._record = record
        for excluded in maps.excluded:
            self._publish_excluded(excluded)
        self._disagreements = disagreements(maps, AT_START)
        for one in self._disagreements:
            log.warning("%s; their positions count as that uncertain", one)
            record(DrivesDisagree(str(one), round(one.apart_m, 1)))
            text = f"Lookback: drives of the map are {one.apart_m:.0f} m apart"
            status_text(text, mavlink.MAV_SEVERITY_WARNING)
        self.checksums = maps.checksum_schedule()

    def check_next(self, maps: MapSet, first: Sequence[Path]) -> MapSet | None:
        """Check a further piece, of the maps in `first` before others; the maps that are left if one is damaged."""
        damaged = self.checksums.step(CHECK_BYTES, first)
        if not damaged:
            return None
        maps = maps.without(damaged)
        self._publish_excluded(maps.excluded[-1])
        return maps

    def as_uncertain(self, maps: MapSet) -> MapSet:
        """The maps, the positions of drives that disagree as uncertain as they are apart."""
        return as_uncertain(maps, self._disagreements)

    def _publish_excluded(self, excluded: ExcludedMap) -> None:
        excluded.log()
        self._record(MapExcluded(excluded.name, excluded.why))
