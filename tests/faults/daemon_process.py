"""`lookback run` as its own process, with the test as its service manager."""

from __future__ import annotations

import contextlib
import os
import re
import select
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

from tests.common import PATIENCE_S


class Process:
    """`lookback run` as its own process, with this test as its service manager."""

    def __init__(
        self, config: Path, folder: Path, environment: dict[str, str], wrapper: list[str], manager_reads: bool
    ) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(str(folder / "notify"))
        if not manager_reads:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender, contextlib.suppress(BlockingIOError):
                sender.connect(str(folder / "notify"))
                sender.setblocking(False)
                while True:
                    sender.send(b"STATUS=full")
        self._errors = (folder / "stderr").open("w+")
        self.popen = subprocess.Popen(
            [*wrapper, sys.executable, "-m", "edge", "run", str(config)],
            env={**os.environ, "NOTIFY_SOCKET": str(folder / "notify"), **environment},
            stderr=self._errors,
        )

    def word(self, timeout_s: float) -> str | None:
        """The next thing it tells systemd; None when it says nothing for that long."""
        self._socket.settimeout(timeout_s)
        try:
            return self._socket.recv(65536).decode()
        except (TimeoutError, BlockingIOError):
            return None

    def wait_for_word(self, beginning: str, timeout_s: float = PATIENCE_S) -> str:
        """Wait until it says something that begins like that."""
        deadline_s = time.monotonic() + timeout_s
        while time.monotonic() < deadline_s:
            word = self.word(0.2)
            if word is not None and word.startswith(beginning):
                return word
            assert self.popen.poll() is None, self.told()
        raise AssertionError(f"no {beginning!r} in {timeout_s} s: {self.told()}")

    def wait_until_on_the_map(self, *without: str) -> None:
        """Wait for a status of it that names none of these troubles.

        No autopilot is at the other end, which is a trouble by itself once the link has had its time: on a busy machine
        that is before the first match.
        """
        while True:
            status = self.wait_for_word("STATUS=")
            if re.search(r"[= ]on the map$", status) and not any(word in status for word in without):
                return

    def told(self) -> str:
        """What it has written to standard error so far."""
        return Path(self._errors.name).read_text()

    def end(self, by: signal.Signals = signal.SIGTERM) -> tuple[int, float]:
        """Send a signal; the exit code, and how many seconds it took, less those in which it waited for a processor."""
        gone, pid = os.pidfd_open(self.popen.pid), self.popen.pid
        waited_s, told_s = _waited_for_cpu_s(pid), time.monotonic()
        os.kill(pid, by)
        assert select.select([gone], [], [], PATIENCE_S)[0], self.told()
        took_s = time.monotonic() - told_s - (_waited_for_cpu_s(pid) - waited_s)
        os.close(gone)
        return self.popen.wait(), took_s

    def close(self) -> None:
        self.popen.kill()
        self.popen.wait()
        self._errors.close()
        self._socket.close()


def _waited_for_cpu_s(pid: int) -> float:
    """How long the first thread of a process, which may have ended, was ready and did not get to run."""
    return int(Path(f"/proc/{pid}/schedstat").read_text().split()[1]) / 1e9
