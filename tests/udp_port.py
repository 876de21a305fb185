"""A port for the two ends of a link in a test."""

from __future__ import annotations

import itertools
import os
import socket

WORKERS_PORTS = 1000
_LOWEST = 10_000 + WORKERS_PORTS * (int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw")) % 20)
_numbers = itertools.cycle(range(_LOWEST, _LOWEST + WORKERS_PORTS))


def free_port(kind: socket.SocketKind = socket.SOCK_DGRAM) -> int:
    """One of this machine's that nobody uses, and that neither the system nor another worker gives away meanwhile.

    The system gives sockets without a number of their own 32768 and above.
    """
    for port in _numbers:
        with socket.socket(socket.AF_INET, kind) as probe:
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
            return port
    raise AssertionError("cycles")
