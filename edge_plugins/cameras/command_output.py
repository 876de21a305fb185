"""The standard output of a command, as a file that never blocks for longer than it may."""

from __future__ import annotations

import contextlib
import os
import selectors
import shutil
import signal
import subprocess
import threading
import time
from functools import cache

from edge.camera.process_groups import STARTED
from edge.config import without_secrets
from edge.errors import ConfigError

TERMINATE_S = 0.7
LAST_WORDS_S = 0.2
LONGEST_LINE = 200
WITH_US = "setpriv", "--pdeathsig", "TERM", "--"
"""Runs a command that gets SIGTERM when the thread that started it ends, even by SIGKILL; of util-linux, 2.33 on."""


class CommandOutput:
    """Owns a running command. `read` is what PyAV calls."""

    def __init__(self, words: list[str]) -> None:
        """Start the command, without a shell. ConfigError if there is no such program."""
        self.name = words[0]
        self.expires_ns = 0
        """CLOCK_MONOTONIC after which `read` gives up."""
        self.ended = False
        """Whether it has closed its standard output."""
        self.expired = False
        """Whether `read` has given up."""
        self._last_line = b""
        if shutil.which(words[0]) is None:
            raise ConfigError(f"[camera] device: cannot start {self.name}: no such program")
        # The camera's thread blocks all signals. A command that inherited this could not be terminated.
        blocked = signal.pthread_sigmask(signal.SIG_SETMASK, ())
        try:
            self._process = subprocess.Popen(
                [*(WITH_US if _has_setpriv() else ()), *words],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                bufsize=0,
                start_new_session=True,
            )
        except OSError as error:
            raise ConfigError(f"[camera] device: cannot start {self.name}: {error.strerror}") from None
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
        STARTED[self._process.pid] = threading.get_ident()
        assert self._process.stdout is not None
        assert self._process.stderr is not None
        self._output, self._errors = self._process.stdout.fileno(), self._process.stderr.fileno()
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._output, selectors.EVENT_READ)
        self._selector.register(self._errors, selectors.EVENT_READ)

    def read(self, size: int) -> bytes:
        """At most `size` bytes as soon as there are some; b"" at the end, and when the time has expired.

        An error here would be one of PyAV's, which prints all but the first with a traceback.
        """
        while True:
            wait_s = (self.expires_ns - time.monotonic_ns()) / 1e9
            if wait_s <= 0:
                self.expired = True
                return b""
            ready = {key.fd for key, _ in self._selector.select(wait_s)}
            if self._errors in ready:
                self._read_errors()
            if self._output in ready:
                data = os.read(self._output, size)
                self.ended = not data
                return data

    def _read_errors(self) -> None:
        """Keep the last line of what it has written to standard error."""
        data = os.read(self._errors, 65536)
        if not data:
            self._selector.unregister(self._errors)
        said = [line for line in (self._last_line + data).splitlines(keepends=True) if line.strip()]
        self._last_line = said[-1][-LONGEST_LINE:] if said else b""

    def why_ended(self) -> str:
        """After the end of `read`: the exit status, if any, and the last line that it wrote to standard error."""
        if not self.ended:
            return f"{self.name}: gave no image in time{self._in_its_words()}"
        self._selector.unregister(self._output)
        while self._selector.get_map() and self._selector.select(LAST_WORDS_S):
            self._read_errors()
        try:
            status = self._process.wait(TERMINATE_S)
        except subprocess.TimeoutExpired:
            return f"{self.name}: closed its standard output{self._in_its_words()}"
        how = f"was ended by {signal.Signals(-status).name}" if status < 0 else f"exited with status {status}"
        return f"{self.name}: {how}{self._in_its_words()}"

    def _in_its_words(self) -> str:
        text = self._last_line.decode(errors="replace")
        words = without_secrets("".join(letter if letter.isprintable() else " " for letter in text).strip())
        return f": {words}" if words else ""

    def close(self) -> None:
        """End the command and all that it started; more than once is harmless."""
        for number in (signal.SIGTERM, signal.SIGKILL):
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._process.pid, number)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(TERMINATE_S)
        STARTED.pop(self._process.pid, None)
        self._selector.close()
        for pipe in (self._process.stdout, self._process.stderr):
            if pipe is not None:
                pipe.close()


@cache
def _has_setpriv() -> bool:
    """Not where it is BusyBox's, which lacks the option."""
    tried = [*WITH_US, "true"]
    return (
        shutil.which(tried[0]) is not None and subprocess.run(tried, capture_output=True, check=False).returncode == 0
    )
