"""A file of what bounds the autopilot's position, which outlives this program: `PositionEstimator.snapshot`.

It is replaced without a flush to the disk: it has to outlive this program, not this computer's power.
"""

from __future__ import annotations

import contextlib
from functools import partial
from pathlib import Path

from edge.files import Behind

BOOT_ID = Path("/proc/sys/kernel/random/boot_id")


class KeptBound:
    """The newest snapshot, beside the boot of this computer that its times are of."""

    def __init__(self, path: Path | None) -> None:
        """path: None keeps nothing."""
        self._path, self._behind = path, Behind()
        self._boot = BOOT_ID.read_bytes().strip()
        self._kept = b""

    def read(self) -> bytes:
        """What an earlier run has kept in this boot of the computer, else b""."""
        data = b""
        if self._path is not None:
            with contextlib.suppress(OSError):
                data = self._path.read_bytes()
        boot, _, kept = data.partition(b"\n")
        return kept if boot == self._boot else b""

    def keep(self, snapshot: bytes) -> None:
        """Replace what is kept, where it is another; b"" deletes it."""
        if self._path is None or snapshot == self._kept:
            return
        self._kept = snapshot
        self._behind.start(partial(_replace, self._path, self._boot + b"\n" + snapshot if snapshot else b""))


def _replace(path: Path, data: bytes) -> None:
    with contextlib.suppress(OSError):  # a full disk costs the memory, not the flight
        if data:
            new = path.with_name(f"{path.name}.new")
            new.write_bytes(data)
            new.replace(path)
        else:
            path.unlink(missing_ok=True)
