"""A camera that shows nothing for a while: all say so in the same words, nothing old is sent, and it comes back."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pymavlink.dialects.v20 import common as mavlink

from edge.camera.feed import FeedImages, read_feed
from edge.health import MAV_STATES
from edge.telemetry.journal import read_journal
from sim.autopilot import EXTERNAL_POSITION_ESTIMATE

LENGTH = 10
FAULT_FROM, FAULT_TO = 35, 51
FROZEN_TOLD_AFTER = 11
"""A picture is frozen once it has not changed for two seconds."""
Image = NDArray[np.uint8]


def lost(bench: Any, image: Image, last: Image) -> Image | None:
    bench.frames.health = replace(bench.frames.health, state="lost", reason="/dev/video0: unplugged")
    return None


def black(bench: Any, image: Image, last: Image) -> Image | None:
    return np.zeros_like(image)


def frozen(bench: Any, image: Image, last: Image) -> Image | None:
    return last


@pytest.fixture
def images(street: Path) -> list[Image]:
    feed = FeedImages(read_feed(street / "feed"))
    return [feed.read(row) for row in range(80)]


@pytest.fixture
def manager(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[socket.socket]:
    """systemd's end of what the daemon tells it."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "notify"))
        manager.setblocking(False)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        yield manager


@pytest.mark.parametrize(
    ("fault", "words", "silent_after"),
    [
        (lost, "blind, camera: /dev/video0: unplugged", 1),
        (black, "blind, camera: the picture is blank; is the lens covered, or the exposure wrong?", 4),
        (frozen, "blind, camera: the picture is frozen", FROZEN_TOLD_AFTER),
    ],
)
def test_a_blindness(
    fault: Callable[[Any, Image, Image], Image | None],
    words: str,
    silent_after: int,
    images: list[Image],
    make_bench: Callable[..., Any],
    write_config: Callable[..., Path],
    tmp_path: Path,
    manager: socket.socket,
    figures: Callable[[str], None],
) -> None:
    bench = make_bench(
        write_config(telemetry={"emit": "external_position"}, gates={"min_interval_s": 0.2, "near_matches": 1})
    )
    status, states = "", []
    fixes_at: list[int] = []
    for number in range(-20, 80):
        image = images[number] if number >= 0 else None
        if FAULT_FROM <= number < FAULT_TO:
            image = fault(bench, images[number], images[FAULT_FROM - 1])
        else:
            bench.frames.health = replace(bench.frames.health, state="running", reason="")
        before = len(sent(bench, EXTERNAL_POSITION_ESTIMATE))
        bench.step(image, number)
        fixes_at += [number] * (len(sent(bench, EXTERNAL_POSITION_ESTIMATE)) - before)
        states.append(bench.daemon.condition.health)
        status = newest_status(manager) or status
        assert status == f"STATUS={bench.daemon.condition.health}"
    told = [item.message.text for item in bench.autopilot.received if item.message.get_type() == "STATUSTEXT"]
    pilot_told = "".join(told).count(words)
    journalled = [record for record in read_journal(tmp_path / "events.jsonl") if record["event"] == "state"]
    spoken = [f"{state.state}: {state.why}" if state.why else state.state for state in states]
    order = list(dict.fromkeys(spoken))
    assert [f"{line['state']}: {line['why']}" if line["why"] else line["state"] for line in journalled][1:] == [
        spoken[at] for at in range(1, len(spoken)) if spoken[at] != spoken[at - 1]
    ]
    assert f"degraded: {words}" in order
    assert pilot_told == 1
    blind = [number - 20 for number, state in enumerate(states) if words in state.why]
    assert FAULT_FROM <= blind[0] <= FAULT_FROM + silent_after
    assert blind[-1] in (FAULT_TO - 1, FAULT_TO)
    heartbeats = [item.message.system_status for item in bench.autopilot.received if is_heartbeat(item.message)]
    assert mavlink.MAV_STATE_CRITICAL in heartbeats[len(heartbeats) // 2 :]
    assert set(heartbeats) <= set(MAV_STATES.values())
    assert len(heartbeats) >= 19, "once a second, blind or not"

    assert [at for at in fixes_at if at < FAULT_FROM], "it was on the map before"
    assert [at for at in fixes_at if FAULT_FROM + silent_after < at < FAULT_TO + LENGTH - 1] == []
    assert [at for at in fixes_at if at >= FAULT_TO + LENGTH - 1], "and is again"
    assert states[-1].state == "on the map"
    figures(f"blind at frames {blind[0]} to {blind[-1]}, fixes at {fixes_at}")


def sent(bench: Any, command: int) -> list[Any]:
    return [
        item.message
        for item in bench.autopilot.received
        if item.message.get_type() == "COMMAND_INT" and item.message.command == command
    ]


def is_heartbeat(message: Any) -> bool:
    return bool(message.get_type() == "HEARTBEAT")


def newest_status(manager: socket.socket) -> str:
    newest = ""
    while True:
        try:
            word = manager.recv(4096).decode()
        except BlockingIOError:
            return newest
        if word.startswith("STATUS="):
            newest = word
