"""Messages to systemd (sd_notify), silent where it did not start the program; and the signals that it sends."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
from collections.abc import Callable, Iterator
from types import FrameType

STOPS = (signal.SIGTERM, signal.SIGINT)
MANAGER_S = 1.0
"""A service manager that does not read fills its socket: do not wait for it any longer."""


@contextlib.contextmanager
def on_stop_signal(then: Callable[[], object]) -> Iterator[None]:
    """Call `then` at the first SIGTERM or SIGINT; ignore all that follow.

    Signals come in pairs (timeout(1) sends two). The second would interrupt the handler of the first, and could
    deadlock on the lock of an Event that is being set.
    """
    stopped = False

    def handle(number: int, at: FrameType | None) -> None:
        nonlocal stopped
        stopped = True
        for each in STOPS:
            signal.signal(each, signal.SIG_IGN)
        then()

    before = [signal.signal(each, handle) for each in STOPS]
    try:
        yield
    finally:
        if not stopped:  # otherwise they stay ignored until the process ends
            for each, handler in zip(STOPS, before, strict=True):
                signal.signal(each, handler)


def notify(state: str, *, wait_s: float = MANAGER_S) -> None:
    """Send one message, such as "READY=1" or "STATUS=on the map", to the socket that systemd named.

    A message that is not read within `wait_s` seconds is dropped.
    """
    address = os.environ.get("NOTIFY_SOCKET", "")
    if not address:
        return
    # A leading @ means the abstract namespace.
    name = "\0" + address[1:] if address.startswith("@") else address
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as sock:
        sock.settimeout(wait_s)
        try:
            sock.connect(name)
            sock.sendall(state.encode())
        except OSError:
            return  # the service manager being away is no reason to stop recognizing places
