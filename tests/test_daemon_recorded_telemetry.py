"""What real autopilots said, played into the daemon as its own process, at the pace at which they said it."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
import tomli_w

from edge.config import SamplingConfig
from edge.journal.records import LinkChanged
from edge.telemetry.codec import MavlinkCodec
from edge.telemetry.link_protocol import STREAMS_HZ
from sim.journal import records_of
from sim.vehicle.pty_link import PtyLink, open_pty

ReadTlog = Callable[[str], Iterator[tuple[int, bytes]]]
STREAMS = set(STREAMS_HZ)
STAMPED = {"SYSTEM_TIME", "GLOBAL_POSITION_INT", "LOCAL_POSITION_NED", "ATTITUDE"}
VALUES = {"NAMED_VALUE_FLOAT", "NAMED_VALUE_INT"}
FRAMES, PERIOD_MS = 80, 150
PATIENCE_S = 90.0


class Played:
    """A recording on one end of a cable: what it says, when it is due, and what comes back."""

    def __init__(self, recorded: Iterator[tuple[int, bytes]], cable: PtyLink) -> None:
        frames = list(recorded)
        self._frames = [((at_ns - frames[0][0]) / 1e9, frame) for at_ns, frame in frames]
        self._cable = cable
        self._began_s: float | None = None
        self._next = 0
        self._ours, self._theirs = MavlinkCodec(1, 1), MavlinkCodec(1, 191)
        self._stamps: list[tuple[float, float]] = []  # when it was sent, and boot clock minus ours by it
        self.answers: list[tuple[float, Any]] = []

    def step(self) -> None:
        received = self._ours.decode(self._cable.receive())
        now_s = time.monotonic()
        self.answers += [(now_s, message) for message in received]
        if self.answers and self._began_s is None:
            self._began_s = now_s  # the daemon listens
        while self._began_s is not None and self._frames[self._next][0] <= now_s - self._began_s:
            frame = self._frames[self._next][1]
            self._next += 1
            boots_s = [_boot_s(message) for message in self._theirs.decode(frame)]
            sent_s = time.monotonic()
            if self._cable.send(frame):  # else it is lost, as on a line whose reader is busy
                self._stamps += [(sent_s, boot_s - sent_s) for boot_s in boots_s if boot_s is not None]

    def boot_s(self, now_s: float) -> float:
        """The autopilot's clock: what delays its stamps makes them older, so the newest of a second is the best.

        That of a simulation was seen to run 0.75 % slow, so that a longer memory would be wrong.
        """
        return now_s + max(offset_s for sent_s, offset_s in self._stamps if abs(now_s - sent_s) <= 1.0)

    def heard(self, name: str) -> list[Any]:
        return [message for _, message in self.answers if message.get_type() == name]


def _boot_s(message: Any) -> float | None:
    if message.get_type() == "TIMESYNC" and message.tc1 == 0:
        return float(message.ts1 / 1e9)
    return message.time_boot_ms / 1e3 if message.get_type() in STAMPED else None


@pytest.mark.parametrize("recording", ["ardurover-4.6.3-nogps", "px4-1.18-agp"])
def test_the_daemon_hears_a_real_autopilot(
    read_tlog: ReadTlog, make_street: Callable[..., Path], tmp_path: Path, recording: str
) -> None:
    """Link up, streams asked for, the boot clock right to 20 ms, and with `report` never a position."""
    # Both recorded vehicles stand while the pictured one drives: only a map without distances does not mind.
    sampling = SamplingConfig(by="time", interval_s=PERIOD_MS / 1000)
    street = make_street(range(FRAMES), period_ms=PERIOD_MS, sampling=sampling, is_located=False)
    cable = open_pty()
    played = Played(read_tlog(recording), cable)
    (tmp_path / "lookback.toml").write_text(
        tomli_w.dumps(
            {
                "camera": {"kind": "feed", "device": str(street / "feed")},
                "sampling": msgspec.to_builtins(sampling),
                "map": {"path": str(street / "map")},
                "sequence": {"length": 5},
                "acceptance": {"uniqueness_min": 1.02, "window_m": 10.0, "hold_off_s": 0.5},
                "telemetry": {
                    "connection": f"serial:{cable.device}:921600",
                    "journal": str(tmp_path / "events.jsonl"),
                },
                "page": {"port": 0},
            }
        )
    )
    daemon = subprocess.Popen([sys.executable, "-m", "edge", "run", str(tmp_path / "lookback.toml")])
    try:
        end_s = time.monotonic() + PATIENCE_S
        while daemon.poll() is None:
            assert time.monotonic() < end_s, "the daemon does not end with its feed"
            played.step()
            time.sleep(0.001)
    finally:
        daemon.kill()
        daemon.wait()
        played.step()
        cable.close()
    assert daemon.returncode == 0
    assert "up" in [record.state for record in records_of(tmp_path / "events.jsonl", LinkChanged)]
    asked = {message.param1 for message in played.heard("COMMAND_LONG") if message.command == 511}
    assert asked == STREAMS | ({514} if recording.startswith("px4") else set()), "514: which sensors PX4 fuses"
    kinds = {message.get_type() for _, message in played.answers}
    assert kinds == {"HEARTBEAT", "TIMESYNC", "COMMAND_LONG", "STATUSTEXT", *VALUES}, "and no position"
    # A value is stamped when it is sent; a busy machine sends and reads most of them late.
    errors_s = [
        message.time_boot_ms / 1e3 - played.boot_s(now_s)
        for now_s, message in played.answers
        if message.get_type() in VALUES and message.time_boot_ms
    ]
    assert len(errors_s) >= 3
    assert min(map(abs, errors_s)) < 0.020
