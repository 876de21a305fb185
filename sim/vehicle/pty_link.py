"""A serial cable that needs no hardware: the autopilot's end of a pseudo-terminal."""

from __future__ import annotations

import contextlib
import fcntl
import os
import select
import struct
import termios
import tty

from edge.errors import LinkLost

READ_SIZE = 65536
BUFFER = 4000
"""Bytes that a pseudo-terminal surely holds, of the 4096 of its line discipline."""
MARK = b"\0all of it\0"
PATIENCE_S = 20.0


class PtyLink:
    """Link over the master side; the program that opens `device` is at the other end."""

    def __init__(self) -> None:
        self._master, slave = os.openpty()
        tty.setraw(slave)  # or what we send before anyone opens the device would be echoed to us
        self.device = os.ttyname(slave)
        # Held open: without any opener of the device, reading the master fails.
        self._slave = slave
        os.set_blocking(self._master, False)

    def receive(self) -> bytes:
        """See edge.telemetry.link.Link."""
        try:
            return os.read(self._master, READ_SIZE)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise LinkLost(f"{self.device}: {error.strerror}") from None

    def send(self, data: bytes) -> bool:
        """See edge.telemetry.link.Link; False when nobody reads the device and its buffer is full."""
        try:
            return os.write(self._master, data) == len(data)
        except BlockingIOError:
            return False
        except OSError as error:
            raise LinkLost(f"{self.device}: {error.strerror}") from None

    def fileno(self) -> int:
        """See edge.telemetry.link.Link."""
        return self._master

    def close(self) -> None:
        """Close both ends: the device disappears, also for a program that has it open. Harmless more than once."""
        for fd in (self._master, self._slave):
            if fd >= 0:
                with contextlib.suppress(OSError):
                    os.close(fd)
        self._master = self._slave = -1


def open_pty() -> PtyLink:
    """A new pseudo-terminal; `serial:{link.device}:921600` is the connection to give to the daemon."""
    return PtyLink()


class Cable(PtyLink):
    """A pseudo-terminal on which both directions arrive at once, as no real one promises: runs repeat to the byte.

    The kernel hands bytes on in a thread of its own; each end here waits until all of them are there.
    """

    @property
    def room(self) -> int:
        """Bytes that it takes before the daemon reads again."""
        return BUFFER - self._unread()

    def send(self, data: bytes) -> bool:
        """To the daemon; RuntimeError where it reads too little."""
        wanted = self._unread() + len(data)
        if not super().send(data):
            raise RuntimeError(f"{self.device}: the daemon reads too little")
        while self._unread() < wanted:
            self._wait_for(self._slave)
        return True

    def receive(self) -> bytes:
        """All that the daemon has written."""
        os.write(self._slave, MARK)
        data = b""
        while not data.endswith(MARK):
            self._wait_for(self._master)
            data += super().receive()
        return data[: -len(MARK)]

    def _unread(self) -> int:
        return int(struct.unpack("i", fcntl.ioctl(self._slave, termios.FIONREAD, bytes(4)))[0])

    def _wait_for(self, fd: int) -> None:
        if not select.select([fd], [], [], PATIENCE_S)[0]:
            raise RuntimeError(f"{self.device}: bytes were lost on the way")
