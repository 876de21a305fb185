"""The socket on which a program of this computer requests the way home from the daemon."""

from __future__ import annotations

import socket
import stat
import threading
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.errors import ConfigError
from edge_plugins.home.home_requests import Answer
from edge_plugins.home.local_socket import LocalSocket
from sim.home.client import ask_for_home

UPLOADING = Answer(mavlink.MAV_RESULT_IN_PROGRESS, "uploading 300 m")
VERIFIED = Answer(mavlink.MAV_RESULT_ACCEPTED, "uploaded and verified", 5)
FAILED = Answer(mavlink.MAV_RESULT_FAILED, "no way home: too far")


@pytest.fixture
def listener(tmp_path: Path) -> Iterator[LocalSocket]:
    with closing(LocalSocket(tmp_path / "home.socket")) as made:
        yield made


def test_a_second_daemon_leaves_the_socket_of_the_first(tmp_path: Path, listener: LocalSocket) -> None:
    path = tmp_path / "home.socket"
    with pytest.raises(ConfigError, match=rf"^\[home\] socket: {path}: cannot make it: another daemon listens there"):
        LocalSocket(path)
    assert asked(path, listener, VERIFIED)[0]


def asked(path: Path, listener: LocalSocket, *answers: Answer) -> tuple[bool, list[str]]:
    """What a client gets that asks, while the daemon's side is polled."""
    texts: list[str] = []
    result: list[bool] = []
    client = threading.Thread(target=lambda: result.append(ask_for_home(path, texts.append)))
    client.start()
    while not listener.requested():
        assert client.is_alive()
    for answer in answers:
        listener.reply(answer)
    client.join()
    return result[0], texts


def test_each_answer_arrives(tmp_path: Path, listener: LocalSocket) -> None:
    path = tmp_path / "home.socket"
    assert asked(path, listener, UPLOADING, VERIFIED) == (True, ["uploading 300 m", "uploaded and verified"])
    assert asked(path, listener, FAILED) == (False, ["no way home: too far"])
    assert not listener.requested()


def test_only_its_user_and_group_may_ask(tmp_path: Path, listener: LocalSocket) -> None:
    assert stat.S_IMODE((tmp_path / "home.socket").stat().st_mode) == 0o660


def test_strangers_and_clients_that_leave_request_nothing(tmp_path: Path, listener: LocalSocket) -> None:
    for words in (b"", b"GET / HTTP/1.1\r\n", b"home"):
        with socket.socket(socket.AF_UNIX) as client:
            client.connect(str(tmp_path / "home.socket"))
            client.sendall(words)
        assert not listener.requested()
        assert not listener.requested()
    listener.reply(VERIFIED)  # nobody is there
    assert asked(tmp_path / "home.socket", listener, VERIFIED)[0]


def test_a_silent_client_does_not_keep_others_waiting(tmp_path: Path) -> None:
    now_ns = 0
    path = tmp_path / "home.socket"
    with (
        closing(LocalSocket(path, lambda: now_ns)) as listener,
        socket.socket(socket.AF_UNIX) as silent,
        socket.socket(socket.AF_UNIX) as client,
    ):
        silent.connect(str(path))
        client.connect(str(path))
        client.sendall(b"restore\n")
        assert [listener.requested() for _ in range(3)] == [None] * 3
        now_ns += 1_000_000_001
        assert [listener.requested() for _ in range(2)] == [None, "restore"]
        now_ns += 100_000_000_000
        assert listener.requested() is None, "one that waits for its answer is not sent away"
        listener.reply(VERIFIED)
        assert client.recv(1000)


def test_the_socket_of_a_killed_daemon_is_replaced_and_removed_at_the_end(tmp_path: Path) -> None:
    path = tmp_path / "home.socket"
    with socket.socket(socket.AF_UNIX) as left:
        left.bind(str(path))
    with closing(LocalSocket(path)) as listener:
        assert asked(path, listener, VERIFIED)[0]
    assert not path.exists()


def test_another_file_is_not_replaced(tmp_path: Path) -> None:
    path = tmp_path / "home.socket"
    path.write_text("mine")
    with pytest.raises(ConfigError, match=r"\[home\] socket: .*cannot make it"):
        LocalSocket(path)
    assert path.read_text() == "mine"
