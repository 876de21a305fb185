"""Which drives of a folder of maps are not searched: `.retired.json`, one file, so that one rename changes them all.

Nothing is moved or deleted, so that a daemon goes on with the maps that it has open. A drive is named with the checksum
of its header: another map of the same name is searched. A file that cannot be read retires nothing.
"""

from __future__ import annotations

import logging
from pathlib import Path

import msgspec

from edge.errors import MapError, reason
from edge.files import replacing
from edge.reference_map.store import read_header

RETIRED_FILE = ".retired.json"
KEPT_STEPS = 16
"""Earlier states that `map learn --undo` can go back to: a fortnight of learning once a day."""
Drives = dict[str, str]
"""Name of each retired drive, and the checksum of its header."""
log = logging.getLogger(__name__)


class Retired:
    """The states of a folder, the newest last."""

    def __init__(self, folder: Path) -> None:
        """Read the file."""
        self._file = folder / RETIRED_FILE
        self._states: list[Drives] = []
        try:
            self._states = msgspec.json.decode(self._file.read_bytes(), type=list[Drives])
        except FileNotFoundError:
            pass
        except (OSError, msgspec.DecodeError, UnicodeDecodeError) as error:
            log.warning("%s: cannot read it, so all drives are searched: %s", self._file, reason(error))

    @property
    def drives(self) -> Drives:
        """That are retired now."""
        return self._states[-1] if self._states else {}

    def holds(self, map_path: Path) -> bool:
        """Whether a map of the folder is retired; one whose header is damaged is not."""
        try:
            return map_path.name in self.drives and self.drives[map_path.name] == read_header(map_path).header_sha256
        except MapError:
            return False

    def others(self, map_paths: list[Path]) -> list[Path]:
        """Those that are not retired; all of them if all are, since those that replaced them are gone."""
        return [path for path in map_paths if not self.holds(path)] or map_paths

    def replace(self, drives: Drives) -> None:
        """Retire these, and no others. MapError if the file cannot be written; then nothing has changed."""
        self._write([*self._states, drives])

    def undo(self) -> None:
        """Go back to the state before. MapError if there is none, or the file cannot be written."""
        if not self._states:
            raise MapError(f"{self._file.parent}: nothing to undo: no drive was ever retired here")
        self._write(self._states[:-1])

    def _write(self, states: list[Drives]) -> None:
        try:
            with replacing(self._file) as stream:
                stream.write(msgspec.json.encode(states[-KEPT_STEPS:]))
        except OSError as error:
            raise MapError(f"{self._file}: cannot write it: {error.strerror}") from None
        self._states = states[-KEPT_STEPS:]
