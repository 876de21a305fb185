"""`lookback map learn` after the last drives, once in each run of the daemon: a process of the lowest priority.

It runs while the vehicle stands, and so never while a sequence is searched: where the vehicle moves, it is ended, and
begins anew at the next halt. It changes one file of the folder, by one rename at its end, which the next start reads.
"""

from __future__ import annotations

import logging
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

STOOD_NS = 20_000_000_000
"""So long the vehicle must have stood: longer than it does in traffic, where nothing would come to its end."""
log = logging.getLogger(__name__)


def learn_command(folder: Path, layers: int) -> list[str]:
    """The command for a folder of maps; layers: drives of one road that stay searched."""
    # -I: no module of the working folder, nor of the environment, is run.
    lookback = [sys.executable, "-I", "-m", "edge"]
    return ["nice", "-n", "19", *lookback, "map", "learn", str(folder), "--layers", str(layers)]


class Learner:
    """Begins, ends and reports the one process."""

    def __init__(self, command: Sequence[str]) -> None:
        """command: see `learn_command`."""
        self._command = command
        self._process: subprocess.Popen[bytes] | None = None
        self._said = tempfile.TemporaryFile()  # noqa: SIM115 - until `close`
        self._stands_since_ns: int | None = None
        self._is_done = False

    def follow(self, now_ns: int, speed_mps: float | None, standing_mps: float) -> None:
        """Go on; a vehicle whose speed is not known may be moving. standing_mps: below which it stands."""
        if self._is_done:
            return
        if speed_mps is None or speed_mps >= standing_mps:
            self._stands_since_ns = None
            self._end()
            return
        since_ns = self._stands_since_ns = now_ns if self._stands_since_ns is None else self._stands_since_ns
        if self._process is None:
            if now_ns - since_ns >= STOOD_NS:
                self._begin()
        elif self._process.poll() is not None:
            self._report(self._process.returncode)

    def close(self) -> None:
        """End what still runs."""
        self._is_done = True
        self._end()
        self._said.close()

    def _begin(self) -> None:
        self._said.truncate(0)
        try:
            self._process = subprocess.Popen(
                self._command, stdin=subprocess.DEVNULL, stdout=self._said, stderr=subprocess.STDOUT
            )
        except OSError as error:
            self._is_done = True
            log.warning("cannot learn from the last drives: %s", error.strerror)

    def _end(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None

    def _report(self, code: int) -> None:
        self._is_done, self._process = True, None
        self._said.seek(0)
        lines = self._said.read().decode(errors="replace").splitlines()
        for line in lines if code == 0 else lines[-1:]:
            log.log(logging.WARNING if code else logging.INFO, "learned: %s" if code == 0 else "not learned: %s", line)
