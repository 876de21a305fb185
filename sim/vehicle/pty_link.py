"""A serial cable that needs no hardware: the autopilot's end of a pseudo-terminal."""

from __future__ import annotations

import contextlib
import os
import tty

from edge.errors import LinkLost

READ_SIZE = 65536


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
