"""A peer given by name: nobody waits for the network to say where it is."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable

from edge.telemetry.codec import MavlinkCodec
from edge.telemetry.link import parse_connection
from edge.telemetry.port import Port, look_up
from tests.common import PATIENCE_S


def open_port(name: str, look_up: Callable[[str], str]) -> Port:
    return Port(parse_connection(f"udp:{name}:14550"), MavlinkCodec(1, 191), lambda: 0, look_up)


def poll_until(port: Port, condition: Callable[[], bool]) -> None:
    give_up_s = time.monotonic() + PATIENCE_S
    while not condition():
        port.open_if_due(10**12)
        assert time.monotonic() < give_up_s


def test_a_lookup_that_hangs_holds_nobody_up() -> None:
    let_go, asked, waited_for = threading.Event(), [], []

    def hang(name: str) -> str:
        asked.append(name)
        if not let_go.wait(PATIENCE_S):
            waited_for.append(name)
        return "127.0.0.1"

    port = open_port("gcs.local", hang)
    assert [port.open_if_due(turn) for turn in range(1000)] == [False] * 1000
    assert not waited_for
    assert asked == ["gcs.local"]
    let_go.set()
    poll_until(port, lambda: port.is_open)
    assert asked == ["gcs.local"]
    port.close()


def test_a_host_that_is_not_known_is_a_closed_port_with_a_reason() -> None:
    def unknown(name: str) -> str:
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

    port = open_port("nowhere.local", unknown)
    poll_until(port, lambda: bool(port.why_closed))
    assert port.why_closed == "nowhere.local: cannot find this host: Name or service not known"
    assert not port.is_open


def test_a_name_that_cannot_be_one_is_a_closed_port_with_a_reason() -> None:
    port = open_port("vehicle..local", look_up)
    poll_until(port, lambda: bool(port.why_closed))
    assert port.why_closed.startswith("vehicle..local: cannot find this host: ")
    assert not port.is_open


def test_an_address_is_not_looked_up() -> None:
    def never(name: str) -> str:
        raise AssertionError(name)

    port = open_port("127.0.0.1", never)
    assert port.open_if_due(0)
    port.close()
