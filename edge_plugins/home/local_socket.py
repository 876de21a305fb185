"""A socket of this computer on which `lookback home` requests the way home from the daemon, or the mission before it.

A client connects and sends one line within a second: `home` or `restore`. The answers are JSON objects, one per line;
the connection ends after the final one. The file's mode permits the daemon's user and group only.
"""

from __future__ import annotations

import contextlib
import errno
import logging
import socket
import time
from collections.abc import Callable
from pathlib import Path
from typing import Literal, TypeAlias

import msgspec

from edge.errors import ConfigError, reason
from edge_plugins.home.home_requests import Answer

Request: TypeAlias = Literal["home", "restore"]
REQUESTS: dict[bytes, Request] = {b"home\n": "home", b"restore\n": "restore"}
SILENT_NS = 1_000_000_000
"""How long a client may be connected without a request, while others wait."""
MODE = 0o660
log = logging.getLogger(__name__)


class LocalSocket:
    """Accepts one client at a time; nothing in here blocks."""

    def __init__(self, path: Path, clock_ns: Callable[[], int] = time.monotonic_ns) -> None:
        """ConfigError where the socket cannot be made."""
        self._path, self._clock_ns = path, clock_ns
        self._silent_ns = 0  # when the client is sent away
        self._is_answered = False  # the client has requested something
        self._client: socket.socket | None = None
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._listener.setblocking(False)
        try:
            if path.is_socket() and not _is_answered(path):
                path.unlink()  # a daemon that was killed left it
            self._listener.bind(str(path))
            path.chmod(MODE)
            self._listener.listen()
        except OSError as error:
            self._listener.close()
            why = "another daemon listens there; stop it" if error.errno == errno.EADDRINUSE else reason(error)
            raise ConfigError(f"[home] socket: {path}: cannot make it: {why}") from None

    def requested(self) -> Request | None:
        """What a client has just requested; its answers go to `reply`."""
        if self._client is None:
            with contextlib.suppress(OSError):
                self._client, _ = self._listener.accept()
                self._client.setblocking(False)
                self._silent_ns, self._is_answered = self._clock_ns() + SILENT_NS, False
        if self._client is None:
            return None
        try:
            data = self._client.recv(max(map(len, REQUESTS)))
        except BlockingIOError:
            if not self._is_answered and self._clock_ns() > self._silent_ns:
                self._hang_up()
            return None
        except OSError:
            data = b""
        request = REQUESTS.get(data)
        if request is None:  # gone, or no client of ours
            self._hang_up()
        self._is_answered = request is not None
        return request

    def reply(self, answer: Answer) -> None:
        """Send an answer to the client that requested it, if it still listens."""
        line = msgspec.json.encode(answer) + b"\n"
        with contextlib.suppress(OSError):
            if self._client is not None:
                self._client.send(line)
        if answer.is_final:
            self._hang_up()

    def close(self) -> None:
        """Remove the socket; more than once is harmless."""
        self._hang_up()
        if self._listener.fileno() >= 0:
            self._listener.close()
            with contextlib.suppress(OSError):
                self._path.unlink()

    def _hang_up(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None


def _is_answered(path: Path) -> bool:
    """Whether somebody listens on a socket; one whose queue is full does."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.setblocking(False)
        try:
            probe.connect(str(path))
        except ConnectionRefusedError:
            return False
        except BlockingIOError:
            return True
    return True
