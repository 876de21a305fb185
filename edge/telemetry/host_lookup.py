"""The address of a host by its name, without waiting: with the network down, a lookup takes many seconds."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable

from edge.errors import LinkLost

LookUp = Callable[[str], str]


def look_up(name: str) -> str:
    """The first address of a host; blocks. OSError when it has none."""
    return str(socket.getaddrinfo(name, None, type=socket.SOCK_DGRAM)[0][4][0])


def is_address(host: str) -> bool:
    """Whether a host is given as an address, so that nothing has to be asked of anyone."""
    try:
        socket.getaddrinfo(host, None, flags=socket.AI_NUMERICHOST)
    except OSError:
        return False
    return True


class Lookup:
    """One lookup, in a thread of its own that nobody waits for."""

    def __init__(self, name: str, look_up: LookUp = look_up) -> None:
        self._name = name
        self._look_up = look_up
        self._address = ""
        self._failure: OSError | None = None
        self._done = threading.Event()
        threading.Thread(target=self._run, name="lookup", daemon=True).start()

    def address(self) -> str | None:
        """The address; None while it is still looked for. LinkLost when there is none."""
        if not self._done.is_set():
            return None
        if self._failure is not None:
            raise LinkLost(f"{self._name}: cannot find this host: {self._failure.strerror}")
        return self._address

    def _run(self) -> None:
        try:
            self._address = self._look_up(self._name)
        except OSError as error:
            self._failure = error
        finally:
            self._done.set()
