"""Words to systemd (sd_notify): ready, watchdog, status. Silent where systemd did not start the program."""

from __future__ import annotations

import os
import socket


def notify(state: str) -> None:
    """Send one message, such as "READY=1" or "STATUS=on the map", to the socket that systemd named."""
    address = os.environ.get("NOTIFY_SOCKET", "")
    if not address:
        return
    # A leading @ means the abstract namespace.
    name = "\0" + address[1:] if address.startswith("@") else address
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as sock:
        try:
            sock.connect(name)
            sock.sendall(state.encode())
        except OSError:
            return  # the service manager being away is no reason to stop recognising places
