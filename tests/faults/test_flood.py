"""Half-sent requests to the live page, from one address and from many: the daemon goes on, and its owner is served."""

from __future__ import annotations

import contextlib
import http.client
import resource
import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("uvicorn")

from edge_plugins.page.connections import CONNECTIONS

SERVICE_FILES = 1024
"""What systemd lets a service open."""
HALF = b"GET / HTTP/1.1\r\nHost: localhost\r\nX: "


@pytest.fixture
def many_files() -> Iterator[None]:
    """Lets this process open as many sockets as it may."""
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (limits[1], limits[1]))
    yield
    resource.setrlimit(resource.RLIMIT_NOFILE, limits)


def one_address(number: int) -> str:
    return "127.0.0.1"


def many_addresses(number: int) -> str:
    return f"127.0.{1 + number // 250}.{1 + number % 250}"


@pytest.mark.parametrize("heads", [1500, pytest.param(15_000, marks=pytest.mark.soak)])
def test_half_sent_heads_neither_end_the_daemon_nor_shut_its_page(
    heads: int,
    many_files: None,
    write_config: Callable[..., Path],
    calm_feed: Path,
    start: Callable[..., Any],
    proc: Any,
    figures: Callable[[str], None],
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    process = start(
        write_config(camera={"device": str(calm_feed)}, page={"port": port}),
        wrapper=["sh", "-c", f'ulimit -n {SERVICE_FILES}; exec "$@"', "sh"],
    )
    process.wait_until_on_the_map()
    before, most, answers = proc.open_descriptors(process.popen.pid), 0, []

    def ask() -> int:
        with contextlib.closing(http.client.HTTPConnection("127.0.0.1", port, 60)) as owner:
            owner.request("GET", "/healthz")
            return owner.getresponse().status

    for address in (one_address, many_addresses):
        with contextlib.ExitStack() as opened:
            for number in range(heads):
                half = socket.create_connection(("127.0.0.1", port), 60, source_address=(address(number), 0))
                opened.enter_context(half)
                half.send(HALF)
                if number % (heads // 15) == 0:
                    most = max(most, proc.open_descriptors(process.popen.pid))
                    answers.append(ask())
            answers.append(ask())
    figures(f"2 x {heads} half-sent heads: {most - before} more files at most; answers {sorted(set(answers))}")
    assert set(answers) == {200}
    assert most - before < 2 * CONNECTIONS
    process.wait_for_word("WATCHDOG=1")
    assert "Traceback" not in process.told()
