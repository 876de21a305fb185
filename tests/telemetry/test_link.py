"""Links over real pseudo-terminals and sockets."""

from __future__ import annotations

import contextlib
import random
import select
import socket
from contextlib import closing
from pathlib import Path
from typing import Any

import msgspec
import pytest

from edge.config import Config, TelemetryConfig
from edge.errors import ConfigError, LinkLost
from edge.telemetry import open_link
from edge.telemetry.codec import MavlinkCodec
from edge.telemetry.link import Link, UdpLink, parse_connection
from edge.telemetry.port import Port
from edge_plugins.doctor.findings import DoctorContext
from edge_plugins.doctor.setup import check_links
from sim.vehicle.pty_link import open_pty
from tests.udp_port import free_port


def receive(link: Link, size: int) -> bytes:
    """Wait for that many bytes."""
    data = b""
    while len(data) < size:
        assert select.select([link], [], [], 5.0)[0], f"only {data!r} came"
        data += link.receive()
    return data


@pytest.mark.parametrize(
    "connection",
    [
        "",
        "serial",
        "serial:/dev/ttyACM0",
        "serial:/dev/ttyACM0:fast",
        "serial:/dev/ttyACM0:0",
        "serial::57600",
        "tls:localhost:5760",
        "udp://127.0.0.1:14550",
        "udp:14550",
        "udp:localhost:70000",
        "udpin:0.0.0.0:-1",
        "udpin:0.0.0.0:14551@vehicle",
        "udp:127.0.0.1:14551@127.0.0.1",
    ],
)
def test_a_malformed_connection_is_one_line_that_names_the_key(connection: str) -> None:
    with pytest.raises(
        ConfigError, match=r"^\[telemetry\] connection: '.*' is not .*$|^\[telemetry\].*is not a "
    ) as error:
        open_link(connection)
    assert "\n" not in str(error.value)


def test_connections_that_are_well_formed() -> None:
    serial = parse_connection("serial:/dev/serial/by-id/usb-ArduPilot_00:1-if00:921600")
    assert (serial.target, serial.number) == ("/dev/serial/by-id/usb-ArduPilot_00:1-if00", 921600)
    assert parse_connection("udp:[::1]:14550").target == "::1"
    bound = parse_connection("udpin:0.0.0.0:14551@192.168.1.20")
    assert (bound.target, bound.number, bound.only_from) == ("0.0.0.0", 14551, "192.168.1.20")
    assert str(bound) == "udpin:0.0.0.0:14551@192.168.1.20"


@pytest.mark.parametrize(
    ("connection", "warned"),
    [
        ("serial:/dev/ttyAMA0:921600", False),
        ("udpin:127.0.0.1:14551", False),
        ("udp:localhost:14551", False),
        ("udpin:0.0.0.0:14551@127.0.0.1", False),
        ("tcpin:0.0.0.0:5760", True),
        ("udpin:0.0.0.0:14551@192.168.1.20", True),
        ("udp:vehicle.local:14550", True),
    ],
)
def test_doctor_warns_of_a_link_that_a_stranger_may_reach_unsigned(
    connection: str, warned: bool, tmp_path: Path
) -> None:
    ((level, words, _),) = check_links(examined(connection=connection))
    assert level == ("note" if warned else "good")
    assert ("can speak in the autopilot's name" in words) == warned
    key = tmp_path / "key"
    key.write_bytes(bytes(32))
    key.chmod(0o600)
    keys = {"signing_key": str(key), "signing_clock": str(tmp_path / "c")}
    ((level, words, _),) = check_links(examined(connection=connection, **keys))
    assert "signed" in words and level == "good"


def examined(**telemetry: str) -> DoctorContext:
    config = Config(telemetry=msgspec.convert(telemetry, TelemetryConfig))
    return DoctorContext(None, Path("/dev"), 0.0, config=config)


@pytest.mark.parametrize("kind", ["udp", "tcp"])
def test_a_link_that_is_bound_to_a_host_ignores_all_others(kind: str) -> None:
    address = f"127.0.0.1:{free_port()}"
    for host, expected in (("127.0.0.2", b""), ("127.0.0.1", b"hello")):
        with (
            closing(open_link(f"{kind}in:{address}@{host}")) as listener,
            closing(open_link(f"{kind}:{address}")) as sender,
        ):
            with contextlib.suppress(LinkLost):  # the stranger's connection is closed
                sender.send(b"hello")
            assert receive(listener, len(expected)) == expected
            assert listener.receive() == b""


def test_a_flood_of_noise_takes_one_poll_no_longer_than_its_time() -> None:
    """A clock that moves on by 5 ms for each piece that is decoded: 30 datagrams of 60 KB are 900 pieces."""
    address, now_ns, pieces = f"127.0.0.1:{free_port()}", 0, 0

    class Counting(MavlinkCodec):
        def decode(self, data: bytes) -> list[Any]:
            nonlocal now_ns, pieces
            now_ns, pieces = now_ns + 5_000_000, pieces + 1
            return super().decode(data)

    port = Port(parse_connection(f"udpin:{address}"), Counting(1, 191), lambda: now_ns)
    assert port.open_if_due(0)
    noise, stranger = random.Random(5), open_link(f"udp:{address}")
    sent = sum(stranger.send(noise.randbytes(60_000)) for _ in range(30))
    polls_ns, before = [], -1
    while pieces != before:
        before, began_ns = pieces, now_ns
        assert not list(port.receive())
        polls_ns.append(now_ns - began_ns)
    assert max(polls_ns) <= 60_000_000
    assert sent and len(polls_ns) > 3 and pieces * 2048 > 60_000, "what the kernel has kept is read by later polls"
    stranger.close()
    port.close()


def test_serial_carries_bytes_both_ways_and_never_blocks() -> None:
    pty = open_pty()
    link = open_link(f"serial:{pty.device}:921600")
    assert link.receive() == b""
    everything = bytes(range(256))  # with XON, XOFF, CR, LF and ^C: the line must be raw
    assert pty.send(everything)
    assert receive(link, 256) == everything
    assert link.send(everything)
    assert receive(pty, 256) == everything
    link.close()
    link.close()
    pty.close()


def test_a_serial_port_that_nobody_reads_drops_instead_of_blocking() -> None:
    pty = open_pty()
    link = open_link(f"serial:{pty.device}:57600")
    taken = [link.send(bytes(1000)) for _ in range(100)]
    assert taken[0]
    assert not taken[-1]
    link.close()
    pty.close()


def test_an_unplugged_serial_port_is_lost_on_read_and_on_write() -> None:
    for use in ("receive", "send"):
        pty = open_pty()
        link = open_link(f"serial:{pty.device}:57600")
        pty.close()
        with pytest.raises(LinkLost, match=f"{pty.device}: the port is gone"):
            link.receive() if use == "receive" else link.send(b"x")
        link.close()


def test_a_closed_serial_link_is_lost_not_a_crash() -> None:
    pty = open_pty()
    link = open_link(f"serial:{pty.device}:57600")
    link.close()
    for use in (link.receive, link.fileno, lambda: link.send(b"x")):
        with pytest.raises(LinkLost):
            use()
    pty.close()


def test_a_missing_port_and_a_file_that_is_no_port_say_so(tmp_path: Path) -> None:
    with pytest.raises(LinkLost, match="no such port"):
        open_link(f"serial:{tmp_path}/none:57600")
    file = tmp_path / "file"
    file.touch()
    with pytest.raises(LinkLost, match=f"{file}: no serial port; name a device"):
        open_link(f"serial:{file}:57600")


def test_udp_both_ways_and_a_listener_answers_whoever_spoke_last() -> None:
    port = free_port()
    listener = open_link(f"udpin:127.0.0.1:{port}")
    assert not listener.send(b"to nobody")
    callers = [open_link(f"udp:127.0.0.1:{port}") for _ in range(2)]
    for caller in callers:
        assert caller.send(b"hello")
        assert receive(listener, 5) == b"hello"
        assert listener.send(b"you")
        assert receive(caller, 3) == b"you"
    assert callers[0].receive() == b""
    for link in (listener, *callers):
        link.close()


def test_a_kept_peer_is_not_replaced_by_whoever_sends_next() -> None:
    port = free_port()
    listener = UdpLink("127.0.0.1", port, listen=True)
    peer, stranger = (open_link(f"udp:127.0.0.1:{port}") for _ in range(2))
    assert peer.send(b"hello")
    assert receive(listener, 5) == b"hello"
    listener.keeps_peer = True
    assert stranger.send(b"me")
    assert peer.send(b"again")
    assert receive(listener, 5) == b"again"
    assert listener.send(b"you")
    assert receive(peer, 3) == b"you"
    listener.keeps_peer = False
    assert stranger.send(b"me")
    assert receive(listener, 2) == b"me"
    for link in (listener, peer, stranger):
        link.close()


def test_udp_survives_a_peer_that_is_not_there_yet() -> None:
    port = free_port()
    caller = open_link(f"udp:127.0.0.1:{port}")
    for _ in range(5):
        caller.send(b"anyone?")
        assert caller.receive() == b""
    listener = open_link(f"udpin:127.0.0.1:{port}")
    caller.send(b"now?")  # may fetch the refusal of an earlier one instead
    caller.send(b"now?")
    assert receive(listener, 4).startswith(b"now?")
    listener.close()
    caller.close()


def test_a_taken_udp_port_and_an_unknown_host_are_lost_links() -> None:
    port = free_port()
    first = open_link(f"udpin:127.0.0.1:{port}")
    with pytest.raises(LinkLost, match=f"127.0.0.1:{port}: cannot open it: Address already in use"):
        open_link(f"udpin:127.0.0.1:{port}")
    first.close()
    with pytest.raises(LinkLost, match=r"no-such-host\.invalid:14550: cannot find this host"):
        open_link("udp:no-such-host.invalid:14550")


def test_tcp_both_ways_and_the_next_client_is_accepted_when_one_has_gone() -> None:
    port = free_port(socket.SOCK_STREAM)
    server = open_link(f"tcpin:127.0.0.1:{port}")
    assert not server.send(b"to nobody")
    assert server.receive() == b""
    for _ in range(2):
        client = open_link(f"tcp:127.0.0.1:{port}")
        assert select.select([], [client], [], 5.0)[1], "it is connected"
        assert client.send(b"hello")
        assert select.select([server], [], [], 5.0)[0]
        assert receive(server, 5) == b"hello"
        assert server.send(b"you")
        assert receive(client, 3) == b"you"
        client.close()
        assert select.select([server], [], [], 5.0)[0], "that it has gone can be read"
        assert server.receive() == b""
    server.close()


def test_a_server_that_refuses_or_goes_away_is_a_lost_link() -> None:
    port = free_port(socket.SOCK_STREAM)
    refused = open_link(f"tcp:127.0.0.1:{port}")
    assert select.select([refused], [], [], 5.0)[0]
    with pytest.raises(LinkLost, match=f"127.0.0.1:{port}: Connection refused"):
        refused.receive()
    refused.close()
    server = open_link(f"tcpin:127.0.0.1:{port}")
    client = open_link(f"tcp:127.0.0.1:{port}")
    assert select.select([server], [], [], 5.0)[0]
    assert server.receive() == b""
    server.close()
    assert select.select([client], [], [], 5.0)[0]
    with pytest.raises(LinkLost, match=r"the other side has closed it|Connection reset"):
        client.receive()
    client.close()


def test_a_message_that_a_full_buffer_cuts_is_finished_before_the_next() -> None:
    port = free_port(socket.SOCK_STREAM)
    server = open_link(f"tcpin:127.0.0.1:{port}")
    client = open_link(f"tcp:127.0.0.1:{port}")
    assert select.select([server], [], [], 5.0)[0]
    assert server.receive() == b""
    messages = [bytes([number % 251]) * 10_000 for number in range(2000)]
    sent = [message for message in messages if client.send(message)]
    assert len(sent) < len(messages), "a peer that reads nothing costs messages, and blocks nothing"
    got = b""
    while len(got) < sum(map(len, sent)):
        assert select.select([server], [], [], 5.0)[0], f"only {len(got)} bytes came"
        got += server.receive()
        client.send(b"")
    assert got == b"".join(sent)
    client.close()
    server.close()
