"""What the autopilot has signed is played to a daemon that has just been killed, or ended, and started again."""

from __future__ import annotations

import array
import fcntl
import os
import select
import signal
import termios
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import pytest

from edge.journal.records import LinkChanged
from edge.telemetry.codec import MavlinkCodec
from edge.telemetry.signing import STORED_AHEAD, TICKS_PER_S, Signer
from sim import Pose
from sim.journal import records_of
from sim.vehicle.autopilot import SimulatedAutopilot
from sim.vehicle.pty_link import PtyLink, open_pty
from tests.common import PATIENCE_S

KEY = bytes(range(32))
DRIVING = Pose(0.0, 0.0, 0.0, 5.0, 0.0)
PIECE = 40
"""Frames that fit into a terminal's buffer at once."""


class TappedCable:
    """The autopilot's end of a cable, of which somebody records what the autopilot says."""

    def __init__(self, cable: PtyLink) -> None:
        self._cable = cable
        self.recorded: list[bytes] = []
        self.receive, self.fileno, self.close = cable.receive, cable.fileno, cable.close

    def send(self, data: bytes) -> bool:
        self.recorded.append(data)
        return self._cable.send(data)


@contextmanager
def unread(cable: PtyLink) -> Iterator[Callable[[], int]]:
    """How many bytes the daemon has not read yet."""
    device = os.open(cable.device, os.O_RDWR | os.O_NOCTTY)
    count = array.array("i", [0])

    def waiting() -> int:
        fcntl.ioctl(device, termios.FIONREAD, count)
        return count[0]

    try:
        yield waiting
    finally:
        os.close(device)


def told_up(folder: Path) -> int:
    """How often the journal says that an autopilot was heard."""
    return sum(record.state == "up" for record in records_of(folder / "events.jsonl", LinkChanged))


def drive_until(autopilot: SimulatedAutopilot, cable: PtyLink, done: Callable[[], bool], process: Any) -> None:
    deadline_s = time.monotonic() + PATIENCE_S
    while not done():
        assert time.monotonic() < deadline_s, process.told()
        assert process.popen.poll() is None, process.told()
        select.select([cable], [], [], 0.02)
        autopilot.step()


def turns(process: Any) -> None:
    """Wait until the daemon's loop has gone round after this."""
    while process.word(0.0) is not None:
        pass
    for _ in range(2):
        process.wait_for_word("WATCHDOG=1")


@pytest.mark.parametrize(
    ("by", "ahead_s"), [(signal.SIGKILL, STORED_AHEAD / TICKS_PER_S), (signal.SIGTERM, 0.0)], ids=["killed", "ended"]
)
def test_a_recording_is_played_to_a_new_run(
    by: signal.Signals,
    ahead_s: float,
    write_config: Callable[..., Path],
    start: Callable[..., Any],
    tmp_path: Path,
    figures: Callable[[str], None],
) -> None:
    """ahead_s: how much later the autopilot is heard again; a restart takes as long, so its clock is put forward."""
    (tmp_path / "key").write_bytes(KEY)
    (tmp_path / "key").chmod(0o600)
    put_forward_s = 0.0
    signer = Signer(KEY, tmp_path / "theirs", 0, lambda: time.time() + put_forward_s)
    with closing(open_pty()) as cable, unread(cable) as waiting:
        tap = TappedCable(cable)
        autopilot = SimulatedAutopilot(tap, lambda _: DRIVING, time.monotonic_ns, codec=MavlinkCodec(1, 1, signer))
        config = write_config(
            camera={"kind": "v4l2", "device": str(tmp_path / "no-camera")},
            telemetry={
                "connection": f"serial:{cable.device}:921600",
                "signing_key": str(tmp_path / "key"),
                "signing_clock": str(tmp_path / "clock"),
            },
        )
        process = start(config)
        process.wait_for_word("READY=1")
        drive_until(autopilot, cable, lambda: told_up(tmp_path) == 1, process)
        heard_s = time.monotonic()
        drive_until(autopilot, cable, lambda: time.monotonic() > heard_s + 1.0 and waiting() == 0, process)
        process.end(by)
        cable.receive()

        process = start(config)
        process.wait_for_word("READY=1")
        recorded = list(tap.recorded)
        for at in range(0, len(recorded), PIECE):
            for frame in recorded[at : at + PIECE]:
                assert cable.send(frame)
            while waiting():
                turns(process)
        turns(process)
        assert told_up(tmp_path) == 1, "a replay has been believed"
        assert "signed frame rejected: another key, or its timestamp is not new" in process.told()

        put_forward_s = ahead_s
        drive_until(autopilot, cable, lambda: told_up(tmp_path) == 2, process)
        figures(f"{len(recorded)} frames played again, none accepted; heard again {ahead_s:g} s on")
