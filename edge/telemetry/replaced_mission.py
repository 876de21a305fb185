"""A copy of the mission that an upload replaces, and a mark while the upload may be cut off, in a file.

Both are on the disk before the autopilot is asked to change anything. So the start after a kill or a power cut knows
that the autopilot may have a mixture, by which items to recognize it, and what to give back.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

import msgspec
from msgspec.structs import replace

from edge.errors import reason
from edge.files import replacing
from edge.mission import MissionItem
from edge.telemetry.mission_transfer import is_same

log = logging.getLogger(__name__)


class Kept(msgspec.Struct, frozen=True):
    """The file. replaced, uploaded: the missions; is_settled: whether the autopilot cannot have a part of the upload.

    first: number of the first item that counts; 1 where item 0 is the autopilot's own home position.
    """

    system_id: int = 0
    first: int = 0
    replaced: tuple[MissionItem, ...] = ()
    uploaded: tuple[MissionItem, ...] = ()
    is_settled: bool = True


class ReplacedMission:
    """What is kept of the newest upload."""

    def __init__(self, path: Path | None) -> None:
        """path: None keeps it in memory only."""
        self._path, self.kept = path, Kept()
        if path is None:
            return
        try:
            self.kept = msgspec.json.decode(path.read_bytes(), type=Kept)
        except FileNotFoundError:
            pass
        except (OSError, msgspec.DecodeError, UnicodeDecodeError) as error:
            log.warning("%s: ignored, so the mission that was replaced is not known: %s", path, reason(error))

    def items(self, system_id: int) -> tuple[MissionItem, ...]:
        """The mission that was replaced in this vehicle; empty where there was none."""
        return self.kept.replaced if self.kept.system_id == system_id else ()

    def begin(self, system_id: int, first: int, present: Sequence[MissionItem], uploaded: Sequence[MissionItem]) -> str:
        """Keep the present mission, unless it is what earlier uploads have left; returns why that failed, or ""."""
        is_known = self.kept.system_id == system_id and self._explains(present)
        replaced = self.kept.replaced if is_known else tuple(present)
        return self._store(Kept(system_id, first, replaced, tuple(uploaded), is_settled=False))

    def settle(self) -> None:
        """The autopilot has all of the upload, or nothing of it."""
        if not self.kept.is_settled:
            self._store(replace(self.kept, is_settled=True))

    def is_cut_off(self, present: Sequence[MissionItem]) -> bool:
        """Whether it is a part of the upload, or a mixture of that with what it replaced; not if it is another one."""
        before = self.kept.replaced
        pairs = list(zip(present, before, strict=False))[self.kept.first :]
        is_as_before = len(present) == len(before) and all(is_same(item, other) for item, other in pairs)
        return self._explains(present) and not is_as_before

    def _explains(self, present: Sequence[MissionItem]) -> bool:
        """Whether each item is of the upload or of what it replaced: nobody has written another mission since."""
        missions = self.kept.replaced, self.kept.uploaded
        return all(
            any(number < len(one) and is_same(item, one[number]) for one in missions)
            for number, item in enumerate(present)
            if number >= self.kept.first
        )

    def _store(self, kept: Kept) -> str:
        self.kept = kept
        if self._path is None:
            return ""
        try:
            with replacing(self._path) as stream:
                stream.write(msgspec.json.encode(kept))
        except OSError as error:
            log.warning("%s: cannot keep the mission that is replaced: %s", self._path, error.strerror)
            return reason(error)
        return ""
