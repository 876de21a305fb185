"""A request to the daemon that runs on this computer, over its socket: see `edge_plugins.home.local_socket`."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec

from edge.errors import LinkLost
from edge_plugins.home.home_requests import Answer
from edge_plugins.home.local_socket import Request

ANSWER_S = 180.0
"""How long to wait; an upload that is repeated and cleared takes less."""


def ask_for_home(path: Path, on_text: Callable[[str], object], request: Request = "home") -> bool:
    """Request a mission from the daemon that listens on a socket; whether the autopilot now has it.

    on_text: gets each line for people. LinkLost where no daemon answers.
    """
    accepted = False
    for answer in _answers(path, request):
        on_text(answer.text)
        accepted = answer.is_final and answer.is_accepted
    return accepted


def _answers(path: Path, request: Request) -> Iterator[Answer]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
        connection.settimeout(ANSWER_S)
        try:
            connection.connect(str(path))
            connection.sendall(f"{request}\n".encode())
            with connection.makefile("rb") as lines:
                for line in lines:
                    answer = msgspec.json.decode(line, type=Answer)
                    yield answer
                    if answer.is_final:
                        return
        except (OSError, msgspec.DecodeError) as error:
            raise LinkLost(f"{path}: no daemon answers there: {error}; is `lookback run` running?") from None
    raise LinkLost(f"{path}: the daemon ended before it answered")
