"""The wire: bytes in, bytes out, never blocking.

serial:DEVICE:BAUD   a serial port, or anything that looks like one (USB, a pseudo-terminal)
udp:HOST:PORT        sends to that peer, and receives only from it
udpin:HOST:PORT      listens on that port, and sends to the peer that was received last, or to the one that is kept
tcp:HOST:PORT        connects to a server, such as mavlink-router or a simulated autopilot
tcpin:HOST:PORT      waits for one client at a time

After udpin and tcpin, `@ADDRESS` accepts that host only: udpin:0.0.0.0:14551@192.168.1.20
"""

from __future__ import annotations

import contextlib
import errno
import ipaddress
import os
import socket
import termios
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol, TypeAlias, get_args

import serial

from edge.errors import ConfigError, LinkLost, reason

KINDS: TypeAlias = Literal["serial", "udp", "udpin", "tcp", "tcpin"]
READ_SIZE = 65536
MOST_FROM_OTHERS = 1000  # datagrams that one call drops


class Link(Protocol):
    """A byte link to a MAVLink peer. Each method but close() raises LinkLost when the port is gone."""

    def receive(self) -> bytes:
        """Some of what has arrived, of one sender; b"" once there is no more. Never blocks."""

    def send(self, data: bytes) -> bool:
        """Send one whole message, or drop it and return False when the port cannot take it now; never blocks."""

    def fileno(self) -> int:
        """For select: readable when receive() has something."""

    def close(self) -> None:
        """Release the port; more than once is harmless."""


@dataclass(frozen=True)
class Connection:
    """A parsed connection string. `target` is a device or a host, `number` its baud rate or port.

    only_from: the address of the only host that is listened to, "" for any.
    """

    kind: KINDS
    target: str
    number: int
    only_from: str = ""

    @property
    def is_local(self) -> bool:
        """Whether nothing outside this computer reaches it, but by a wire of its own."""
        host = self.only_from or self.target
        with contextlib.suppress(ValueError):
            return self.kind == "serial" or ipaddress.ip_address(host).is_loopback
        return host == "localhost"

    def open(self) -> Link:
        """Open it; LinkLost when it cannot be opened now."""
        if self.kind == "serial":
            return SerialLink(self.target, self.number)
        if self.kind in ("tcp", "tcpin"):
            return TcpLink(self.target, self.number, listen=self.kind == "tcpin", only_from=self.only_from)
        return UdpLink(self.target, self.number, listen=self.kind == "udpin", only_from=self.only_from)

    def __str__(self) -> str:
        return f"{self.kind}:{self.target}:{self.number}" + f"@{self.only_from}" * bool(self.only_from)


def parse_connection(connection: str, where: str = "[telemetry] connection") -> Connection:
    """Check a connection string without opening anything; ConfigError names the key, which is at `where`."""
    kind, _, rest = connection.partition(":")
    rest, at, only_from = rest.rpartition("@") if kind in ("udpin", "tcpin") and "@" in rest else (rest, "", "")
    target, _, number = rest.rpartition(":")
    if kind not in get_args(KINDS) or not target or target.startswith("//"):
        raise ConfigError(f"{where}: {connection!r} is not serial:DEVICE:BAUD, or udp, udpin, tcp or tcpin:HOST:PORT")
    limit = 12_000_000 if kind == "serial" else 65_535
    if not (number.isascii() and number.isdigit() and 0 < int(number) <= limit):
        what = "baud rate" if kind == "serial" else "port"
        raise ConfigError(f"{where}: {connection!r}: {number!r} is not a {what} from 1 to {limit}")
    if at and not is_address(only_from):
        raise ConfigError(f"{where}: {connection!r}: {only_from!r} is not the address of a host")
    return Connection(kind, target.strip("[]"), int(number), only_from)  # type: ignore[arg-type]  # narrowed above


def is_address(text: str) -> bool:
    """Whether a host is given as an address, so that no lookup is needed."""
    with contextlib.suppress(ValueError):
        return bool(ipaddress.ip_address(text))
    return False


def _is_from(sender: str, host: str) -> bool:
    """Whether an address is a host's, also where the socket gives IPv4 as IPv6 (::ffff:192.168.1.20)."""
    address = ipaddress.ip_address(sender.partition("%")[0])
    mapped = getattr(address, "ipv4_mapped", None)
    return ipaddress.ip_address(host) in (address, mapped)


class SerialLink:
    """A serial port in pyserial's exclusive mode, so that two daemons never share one."""

    def __init__(self, device: str, baud: int) -> None:
        self._device = device
        try:
            self._port = serial.Serial(device, baud, timeout=0, write_timeout=0, exclusive=True)
        except (OSError, termios.error) as error:  # SerialException is an OSError
            raise LinkLost(f"{device}: {_why_not_open(device, error)}") from None

    def receive(self) -> bytes:
        """See Link. pyserial reports an unplugged port in three ways, and all of them end here."""
        try:
            return bytes(self._port.read(READ_SIZE))
        except (OSError, termios.error) as error:
            raise LinkLost(f"{self._device}: the port is gone: {reason(error)}") from None

    def send(self, data: bytes) -> bool:
        """See Link. A port whose buffer is full (flow control, nobody reading) drops the message."""
        try:
            # Not Serial.write(), which spins on EAGAIN when its timeout is 0.
            return os.write(self.fileno(), data) == len(data)
        except BlockingIOError:
            return False
        except OSError as error:
            raise LinkLost(f"{self._device}: the port is gone: {error.strerror}") from None

    def fileno(self) -> int:
        """See Link."""
        try:
            return int(self._port.fileno())
        except OSError:
            raise LinkLost(f"{self._device}: the port is closed") from None

    def close(self) -> None:
        """See Link."""
        with contextlib.suppress(OSError, termios.error):  # an unplugged port refuses it
            self._port.reset_output_buffer()  # or closing waits while the peer's flow control says stop
        with contextlib.suppress(OSError, termios.error):
            self._port.close()


def _why_not_open(device: str, error: Exception) -> str:
    """Why a port does not open, and what to do about it."""
    number = getattr(error, "errno", None)
    if number == errno.ENOENT:
        return "no such port; is the autopilot plugged in?"
    if number in (errno.EAGAIN, errno.EBUSY):
        return "in use by another program; stop it (ModemManager? a ground station?)"
    if number == errno.EACCES:
        return "not permitted; add the user to the group that owns it (dialout)"
    if Path(device).exists() and not Path(device).is_char_device():
        return "no serial port; name a device, such as /dev/ttyACM0"
    return f"cannot open it: {error}"


def _new_socket(host: str, port: int, kind: socket.SocketKind) -> tuple[socket.socket, Any]:
    """A socket that does not block, and the address as its family has it; LinkLost where the host cannot be found."""
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=kind)[0]
        new = socket.socket(family, kind, protocol)
    except OSError as error:
        raise LinkLost(f"{host}:{port}: cannot find this host: {error.strerror}") from None
    new.setblocking(False)
    return new, address


class UdpLink:
    """A datagram socket. A peer that is not running yet is no error.

    A host name is looked up while opening, which takes seconds when the network is down; an address does not.
    """

    def __init__(self, host: str, port: int, *, listen: bool, only_from: str = "") -> None:
        self._name = f"{host}:{port}"
        self._peer: Any = None  # an address, as the socket's family has it
        self._socket, address = _new_socket(host, port, socket.SOCK_DGRAM)
        try:
            if listen:
                self._socket.bind(address)
            else:
                self._socket.connect(address)  # the kernel then drops what others send
                self._peer = address
        except OSError as error:
            self._socket.close()
            raise LinkLost(f"{self._name}: cannot open it: {error.strerror}") from None
        self._listen, self._only_from = listen, only_from
        self.keeps_peer = False
        """Whether a listening socket ignores all but the peer that was received last."""

    def receive(self) -> bytes:
        """See Link. One datagram; without waiting for those of others to end."""
        for _ in range(MOST_FROM_OTHERS):
            try:
                data, sender = self._socket.recvfrom(READ_SIZE)
            except (BlockingIOError, ConnectionRefusedError):  # refused: the peer's answer to an earlier send
                return b""
            except OSError as error:
                raise LinkLost(f"{self._name}: the socket failed: {error.strerror}") from None
            if (self.keeps_peer and sender != self._peer) or (
                self._only_from and not _is_from(sender[0], self._only_from)
            ):
                continue
            if self._listen:
                self._peer = sender
            return data
        return b""

    def send(self, data: bytes) -> bool:
        """See Link. False while a listening socket has received nothing, or the peer is not running."""
        if self._peer is None:
            return False
        try:
            if self._listen:
                self._socket.sendto(data, self._peer)
            else:
                self._socket.send(data)
        except (BlockingIOError, ConnectionRefusedError):
            return False
        except OSError as error:
            raise LinkLost(f"{self._name}: the socket failed: {error.strerror}") from None
        return True

    def fileno(self) -> int:
        """See Link."""
        return self._socket.fileno()

    def close(self) -> None:
        """See Link."""
        self._socket.close()


class TcpLink:
    """A stream to a server, or from one client at a time; the next client is accepted when that one has gone."""

    def __init__(self, host: str, port: int, *, listen: bool, only_from: str = "") -> None:
        self._name = f"{host}:{port}"
        self._only_from = only_from
        self._server: socket.socket | None = None
        self._peer: socket.socket | None = None
        self._unsent = b""
        """The rest of a message of which the kernel took only a part: it goes first."""
        opened, address = _new_socket(host, port, socket.SOCK_STREAM)
        try:
            if listen:
                opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                opened.bind(address)
                opened.listen(1)
                self._server = opened
            else:
                number = opened.connect_ex(address)
                if number not in (0, errno.EINPROGRESS):
                    raise OSError(number, os.strerror(number))
                opened.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._peer = opened
        except OSError as error:
            opened.close()
            raise LinkLost(f"{self._name}: cannot open it: {error.strerror}") from None

    def receive(self) -> bytes:
        """See Link. LinkLost when the server has gone; a client that has gone makes room for the next."""
        if self._peer is None and not self._accept():
            return b""
        assert self._peer is not None
        try:
            data = self._peer.recv(READ_SIZE)
        except BlockingIOError:
            return b""
        except OSError as error:
            if error.errno == errno.ENOTCONN:  # still connecting
                return b""
            return self._lose(reason(error))
        return data or self._lose("the other side has closed it")

    def send(self, data: bytes) -> bool:
        """See Link. False while nobody is connected."""
        if self._peer is None and not self._accept():
            return False
        assert self._peer is not None
        try:
            if self._unsent:
                self._unsent = self._unsent[self._peer.send(self._unsent) :]
            if self._unsent or not data:
                return False
            self._unsent = data[self._peer.send(data) :]
        except BlockingIOError:
            return False
        except OSError as error:
            if error.errno != errno.ENOTCONN:
                self._lose(reason(error))
            return False
        return True

    def _accept(self) -> bool:
        if self._server is None:
            raise LinkLost(f"{self._name}: it is closed")
        try:
            client, address = self._server.accept()
        except (BlockingIOError, ConnectionAbortedError):
            return False
        except OSError as error:
            raise LinkLost(f"{self._name}: the socket failed: {error.strerror}") from None
        if self._only_from and not _is_from(address[0], self._only_from):
            client.close()
            return False
        self._peer = client
        self._peer.setblocking(False)
        self._peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._unsent = b""
        return True

    def _lose(self, why: str) -> bytes:
        """A client makes room for the next; without the server there is no link."""
        if self._server is None:
            raise LinkLost(f"{self._name}: {why}")
        if self._peer is not None:
            self._peer.close()
        self._peer = None
        return b""

    def fileno(self) -> int:
        """See Link."""
        opened = self._peer or self._server
        if opened is None:
            raise LinkLost(f"{self._name}: it is closed")
        return opened.fileno()

    def close(self) -> None:
        """See Link."""
        for one in (self._peer, self._server):
            if one is not None:
                one.close()
