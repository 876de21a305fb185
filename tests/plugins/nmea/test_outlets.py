"""Who gets sentences: everybody who reads, nobody who does not, and nothing that is old."""

from __future__ import annotations

import json
import os
import select
import shutil
import socket
import subprocess
import threading
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from edge.config import load_config
from edge.errors import ConfigError
from edge.journal.records import PlaceFix
from edge_plugins.nmea import NmeaConfig
from edge_plugins.nmea.outlets import MOST_CLIENTS, PtyOutlet, TcpOutlet
from edge_plugins.nmea.sentences import sentences
from tests.common import PATIENCE_S
from tests.udp_port import free_port

FIX = PlaceFix(10**12, 3, -26.999, 152.001, 60.0, 4.0, 2.0, "forward", "same", 1.2)


@pytest.fixture
def port() -> int:
    return free_port(socket.SOCK_STREAM)


@pytest.fixture
def tcp(port: int) -> Iterator[TcpOutlet]:
    with closing(TcpOutlet("127.0.0.1", port)) as outlet:
        yield outlet


def client_of(port: int) -> socket.socket:
    client = socket.create_connection(("127.0.0.1", port), PATIENCE_S)
    client.settimeout(PATIENCE_S)
    return client


def test_all_clients_get_all_of_it_and_one_that_leaves_costs_nothing(tcp: TcpOutlet, port: int) -> None:
    with client_of(port) as one, client_of(port) as other:
        tcp.send(b"first\r\n")
        assert one.recv(100) == other.recv(100) == b"first\r\n"
        other.close()
        one.sendall(b"what are you?")
        tcp.send(b"second\r\n")
        tcp.send(b"third\r\n")
        assert one.recv(8, socket.MSG_WAITALL) + one.recv(7, socket.MSG_WAITALL) == b"second\r\nthird\r\n"


def test_one_that_does_not_read_is_cut_off_and_the_others_go_on(tcp: TcpOutlet, port: int) -> None:
    with socket.socket() as lazy, client_of(port) as keen:
        lazy.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)
        lazy.settimeout(PATIENCE_S)
        lazy.connect(("127.0.0.1", port))
        line = bytes(200)
        for _ in range(300):
            tcp.send(line)
            assert len(keen.recv(200, socket.MSG_WAITALL)) == 200
        kept = 0
        while data := lazy.recv(65536):  # until the end, which comes
            kept += len(data)
        assert 0 < kept < 100 * len(line)


def test_one_too_many_is_turned_away(tcp: TcpOutlet, port: int) -> None:
    clients = [client_of(port) for _ in range(MOST_CLIENTS + 1)]
    tcp.send(b"x")
    assert sorted(one.recv(1) for one in clients) == [b"", *[b"x"] * MOST_CLIENTS]
    for one in clients:
        one.close()


def test_what_nobody_read_on_the_pty_is_not_there_for_who_comes_later(tmp_path: Path) -> None:
    path = tmp_path / "nmea"
    with closing(PtyOutlet(path)) as outlet:
        reader = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        for number in range(9):
            outlet.send(b"%d\r\n" % number)
            assert select.select([reader], [], [], PATIENCE_S)[0], "the kernel hands bytes on in a thread of its own"
        assert os.read(reader, 4096) == b"8\r\n"
        os.write(reader, b"what are you?")
        outlet.send(b"next\r\n")
        assert select.select([reader], [], [], PATIENCE_S)[0] and os.read(reader, 4096) == b"next\r\n"
        os.close(reader)
    assert not path.is_symlink()


def test_a_link_that_a_killed_daemon_left_is_replaced_and_no_other_file(tmp_path: Path) -> None:
    path = tmp_path / "nmea"
    path.symlink_to("/dev/pts/999999")
    with closing(PtyOutlet(path)):
        assert path.exists()
    path.write_text("mine")
    with pytest.raises(ConfigError, match=r"^\[nmea\] pty: .*nmea: cannot make it: File exists$"):
        PtyOutlet(path)
    assert path.read_text() == "mine"


def test_a_link_to_a_terminal_that_is_of_another_program_now_stops_no_start(tmp_path: Path) -> None:
    ends = os.openpty()
    (tmp_path / "nmea").symlink_to(os.ttyname(ends[1]))
    (tmp_path / "lookback.toml").write_text('[nmea]\npty = "nmea"\n')
    assert load_config(tmp_path / "lookback.toml").of(NmeaConfig).pty == str(tmp_path / "nmea")
    for end in ends:
        os.close(end)


@pytest.mark.skipif(None in map(shutil.which, ("gpsd", "gpspipe")), reason="needs gpsd and gpspipe (gpsd-clients)")
def test_gpsd_reads_position_and_accuracy(tcp: TcpOutlet, port: int) -> None:
    clients, ended = free_port(socket.SOCK_STREAM), threading.Event()

    def send() -> None:
        second = 0
        while not ended.wait(0.05):
            second += 1
            tcp.send(sentences(1_700_000_000 * 10**9 + second * 10**9, FIX, speed_mps=10.0, alt_m=12.0))

    sender = threading.Thread(target=send)
    sender.start()
    served = subprocess.Popen(["gpsd", "-N", "-n", "-S", str(clients), f"tcp://127.0.0.1:{port}"])
    try:
        report, accuracy = reports_of(clients)
    finally:
        served.terminate()
        served.wait(PATIENCE_S)
        ended.set()
        sender.join()
    assert (report["lat"], report["lon"]) == pytest.approx((FIX.lat_deg, FIX.lon_deg), abs=1e-6)
    assert (report["speed"], report["track"], report["altMSL"]) == pytest.approx((10.0, 60.0, 12.0), abs=0.01)
    assert report["status"] == 5, "dead reckoning, as gpsd calls what is estimated"
    assert (accuracy["major"], accuracy["minor"], accuracy["orient"]) == (4.0, 2.0, 60.0)


def reports_of(clients: int) -> tuple[dict[str, float], dict[str, float]]:
    """The first position that gpsd reports, and the accuracy with it."""
    for _ in range(40):  # until gpsd listens
        command = ["timeout", str(PATIENCE_S), "gpspipe", "-w", "-n", "20", f"127.0.0.1:{clients}"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        reports = [json.loads(line) for line in done.stdout.splitlines()]
        positions = [one for one in reports if one["class"] == "TPV" and one["mode"] >= 2 and "speed" in one]
        accuracies = [one for one in reports if one["class"] == "GST"]
        if positions and accuracies:
            return positions[0], accuracies[0]
    raise AssertionError(reports)
