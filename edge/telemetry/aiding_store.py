"""The autopilot's last position aiding, over a restart of this program: `PositionEstimator.snapshot`."""

from __future__ import annotations

from pathlib import Path

import msgspec

from edge.files import BOOT_ID, PersistentFile
from edge.localization import PERIOD_NS, PositionEstimator


class AidingFile(msgspec.Struct, frozen=True):
    """The file: a snapshot, and the boot of this computer that its times are of."""

    boot: str
    snapshot: bytes


class AidingStore:
    """The newest snapshot of a drive. It is not flushed: it has to outlive this program, not this computer's power."""

    def __init__(self, journal: str, drive: PositionEstimator, now_ns: int) -> None:
        """Have the drive go on with what an earlier run has kept beside this journal in this boot; "" keeps nothing."""
        path = Path(journal).with_suffix(".bound") if journal else None
        self._file = PersistentFile(
            path, AidingFile, "the last position aiding of the autopilot is forgotten", is_flushed=False
        )
        self._drive, self.due_ns = drive, 0
        self._kept = AidingFile(BOOT_ID.read_text(encoding="ascii").strip(), b"")
        kept = self._file.read()
        drive.restore(now_ns, kept.snapshot if kept and kept.boot == self._kept.boot else b"")

    def keep(self, now_ns: int) -> None:
        """Where it is another one, at `due_ns`; nothing to keep removes the file."""
        self.due_ns, snapshot = now_ns + PERIOD_NS, self._drive.snapshot()
        if snapshot != self._kept.snapshot:
            self._kept = AidingFile(self._kept.boot, snapshot)
            self._file.write_behind(self._kept if snapshot else None)
