"""Where sentences go: every client of a TCP port, and a pseudo-terminal. Nothing in here blocks.

Old positions are worth nothing: a client that does not read is cut off, and what nobody has read on the pseudo-terminal
goes before more is written.
"""

from __future__ import annotations

import contextlib
import fcntl
import ipaddress
import logging
import os
import socket
import struct
import termios
import tty
from pathlib import Path

from edge.errors import ConfigError, reason

MOST_CLIENTS = 16
OUTLET_READ_SIZE = 4096
SEND_BUFFER = 4096
"""Bytes, which Linux doubles: about half a minute of sentences for a client that does not read, and what it keeps."""
PTY_MODE = 0o666
"""gpsd runs as a user of its own, and opens ports to write as well. Every user reaches a TCP port here, too."""
log = logging.getLogger(__name__)


class TcpOutlet:
    """A server for several clients, who are sent all that comes, and not listened to."""

    def __init__(self, bind: str, port: int) -> None:
        """OSError where the port cannot be had now."""
        family = socket.AF_INET6 if ipaddress.ip_address(bind).version == 6 else socket.AF_INET
        self._listener = socket.create_server((bind, port), family=family, backlog=MOST_CLIENTS)
        self._listener.setblocking(False)
        self._clients: list[socket.socket] = []

    def send(self, data: bytes) -> None:
        """To everybody; new clients are let in first."""
        with contextlib.suppress(OSError):  # none waits, or it has gone
            while True:
                client, address = self._listener.accept()
                client.setblocking(False)
                client.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
                if len(self._clients) < MOST_CLIENTS:
                    self._clients.append(client)
                else:
                    log.warning("NMEA: %s is turned away: %d clients are connected", address[0], MOST_CLIENTS)
                    client.close()
        for client in list(self._clients):
            if not _is_sent(client, data):
                client.close()
                self._clients.remove(client)

    def close(self) -> None:
        """End all connections; more than once is harmless."""
        for one in (*self._clients, self._listener):
            one.close()
        self._clients.clear()


def _is_sent(client: socket.socket, data: bytes) -> bool:
    """Whether a client has taken the whole of it, and has not gone; what it sends is dropped."""
    try:
        with contextlib.suppress(BlockingIOError):
            if not client.recv(OUTLET_READ_SIZE):
                return False
        return client.send(data) == len(data)
    except OSError:
        return False


class PtyOutlet:
    """A pseudo-terminal, for programs that read serial ports only; `path` becomes a link to it."""

    def __init__(self, path: Path) -> None:
        """ConfigError where the link cannot be made."""
        self._path = path
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        os.fchmod(self._slave, PTY_MODE)
        self._device = os.ttyname(self._slave)
        try:
            if path.is_symlink() and str(path.readlink()).startswith("/dev/pts/"):
                path.unlink()  # a daemon that was killed left it
            path.symlink_to(self._device)
        except OSError as error:
            self._close_both()
            raise ConfigError(f"[nmea] pty: {path}: cannot make it: {reason(error)}") from None

    def send(self, data: bytes) -> None:
        """To whoever reads it, if anybody does."""
        (unread,) = struct.unpack("i", fcntl.ioctl(self._slave, termios.FIONREAD, bytes(4)))
        if unread:
            termios.tcflush(self._slave, termios.TCIFLUSH)
        with contextlib.suppress(BlockingIOError):
            os.read(self._master, OUTLET_READ_SIZE)  # gpsd asks a receiver what it is
        with contextlib.suppress(BlockingIOError):
            os.write(self._master, data)

    def close(self) -> None:
        """Remove the link, if it is ours; more than once is harmless."""
        if self._master >= 0:
            with contextlib.suppress(OSError):
                if str(self._path.readlink()) == self._device:
                    self._path.unlink()
            self._close_both()

    def _close_both(self) -> None:
        for end in (self._master, self._slave):
            os.close(end)
        self._master = self._slave = -1
