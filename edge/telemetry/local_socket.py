"""A socket of this computer on which `lookback home --ask` requests the way home from the daemon.

A client connects and sends one line, `home`. The answers are JSON objects, one per line; the connection ends after the
final one. The file's mode permits the daemon's user and group only.
"""

from __future__ import annotations

import contextlib
import logging
import socket
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec

from edge.errors import ConfigError, LinkLost
from edge.telemetry.home_requests import Answer

REQUEST = b"home\n"
ANSWER_S = 180.0
"""How long a client waits; an upload that is repeated and cleared takes less."""
MODE = 0o660
log = logging.getLogger(__name__)


class LocalAnswer(msgspec.Struct, frozen=True):
    """One line of an answer."""

    text: str
    accepted: bool
    final: bool


class LocalSocket:
    """Accepts one client at a time; nothing in here blocks."""

    def __init__(self, path: Path) -> None:
        """ConfigError where the socket cannot be made."""
        self._path = path
        self._client: socket.socket | None = None
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._listener.setblocking(False)
        try:
            if path.is_socket():
                path.unlink()  # a daemon that was killed left it
            self._listener.bind(str(path))
            path.chmod(MODE)
            self._listener.listen(1)
        except OSError as error:
            self._listener.close()
            raise ConfigError(f"[home] socket: {path}: cannot make it: {error.strerror or error}") from None

    def requested(self) -> bool:
        """Whether a client has just requested the way home; its answers go to `reply`."""
        if self._client is None:
            with contextlib.suppress(OSError):
                self._client, _ = self._listener.accept()
                self._client.setblocking(False)
        if self._client is None:
            return False
        try:
            data = self._client.recv(len(REQUEST))
        except BlockingIOError:
            return False
        except OSError:
            data = b""
        if data != REQUEST:  # gone, or no client of ours
            self._hang_up()
        return data == REQUEST

    def reply(self, answer: Answer) -> None:
        """Send an answer to the client that requested it, if it still listens."""
        line = msgspec.json.encode(LocalAnswer(answer.text, answer.is_accepted, answer.is_final)) + b"\n"
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


def ask_for_home(path: Path, on_text: Callable[[str], object]) -> bool:
    """Request the way home from the daemon that listens on a socket; whether the autopilot now has the mission.

    on_text: gets each line for people. LinkLost where no daemon answers.
    """
    accepted = False
    for answer in _answers(path):
        on_text(answer.text)
        accepted = answer.final and answer.accepted
    return accepted


def _answers(path: Path) -> Iterator[LocalAnswer]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
        connection.settimeout(ANSWER_S)
        try:
            connection.connect(str(path))
            connection.sendall(REQUEST)
            with connection.makefile("rb") as lines:
                for line in lines:
                    answer = msgspec.json.decode(line, type=LocalAnswer)
                    yield answer
                    if answer.final:
                        return
        except (OSError, msgspec.DecodeError) as error:
            raise LinkLost(f"{path}: no daemon answers there: {error}; is `lookback run` running?") from None
    raise LinkLost(f"{path}: the daemon ended before it answered")
