"""`lookback dev sim autopilot` as a user has it: over UDP and on a pseudo-terminal."""

from __future__ import annotations

import argparse
import json
import select
import threading

import pytest
from pymavlink.dialects.v20 import common as mavlink

from edge.errors import ConfigError
from edge.telemetry import open_link
from edge.telemetry.codec import MavlinkCodec
from sim.vehicle.command import add_command
from tests.udp_port import free_port


def parse(*arguments: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_command(parser.add_subparsers())
    return parser.parse_args(["autopilot", *arguments])


def test_over_udp_it_speaks_first_and_prints_what_it_hears(capsys: pytest.CaptureFixture[str]) -> None:
    address = f"127.0.0.1:{free_port()}"
    link = open_link(f"udpin:{address}")
    arguments = parse("--udp", address, "--speed", "3", "--seconds", "1.0")
    thread = threading.Thread(target=arguments.run, args=(arguments,))
    thread.start()
    assert select.select([link], [], [], 5.0)[0]
    codec = MavlinkCodec(1, 191)
    assert codec.decode(link.receive())[0].get_type() == "HEARTBEAT"
    link.send(codec.encode(mavlink.MAVLink_statustext_message(6, b"hello", 0, 0)))
    thread.join()
    link.close()
    output = capsys.readouterr()
    (line,) = output.out.splitlines()
    printed = json.loads(line)
    assert (printed["mavpackettype"], printed["text"]) == ("STATUSTEXT", "hello")
    assert output.err == f"speaking to {address}\n"


def test_on_a_pseudo_terminal_it_says_which_connection_to_configure(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = parse("--seconds", "0")
    assert arguments.run(arguments) == 0
    assert capsys.readouterr().err.startswith('connection = "serial:/dev/pts/')


def test_a_malformed_address_names_the_option() -> None:
    arguments = parse("--udp", "localhost")
    with pytest.raises(ConfigError, match="--udp: 'localhost' is not HOST:PORT"):
        arguments.run(arguments)
