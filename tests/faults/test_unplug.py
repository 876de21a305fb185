"""The autopilot's cable is pulled and put back, again and again, under another device name each time."""

from __future__ import annotations

import gc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest

from edge.config import TelemetryConfig
from edge.errors import LinkLost
from edge.telemetry import open_link
from edge.telemetry.autopilot import AutopilotConnection
from sim import Pose
from sim.vehicle.autopilot import SimulatedAutopilot
from sim.vehicle.pty_link import PtyLink, open_pty
from tests.udp_port import free_port

STEP_NS = 20_000_000
HEARTBEAT_WITHIN_S = 2.0
STILL = Pose(0.0, 0.0, 0.0, 0.0, 0.0)
UNPLUGGED_S = (0.3, 1.0, 3.0, 20.0, 300.0)


class Plug:
    """A serial port with a name that stays, /dev/serial/by-id for the kernel's ones, and what is plugged into it."""

    def __init__(self, by_id: Path, clock_ns: Callable[[], int]) -> None:
        self._by_id, self._clock_ns = by_id, clock_ns
        self.names: list[str] = []
        self.autopilot: SimulatedAutopilot | None = None
        self._pty: PtyLink | None = None

    def plug(self) -> None:
        before = [open_pty() for _ in range(len(self.names) % 3)]  # the lowest free number is given
        self._pty = open_pty()
        for pty in before:
            pty.close()
        self.names.append(self._pty.device)
        self._by_id.symlink_to(self._pty.device)
        self.autopilot = SimulatedAutopilot(self._pty, lambda _: STILL, self._clock_ns)

    def unplug(self) -> None:
        assert self._pty is not None
        self._by_id.unlink()
        self._pty.close()
        self._pty = self.autopilot = None

    def close(self) -> None:
        if self._pty is not None:
            self._pty.close()


@pytest.mark.parametrize("times", [50, pytest.param(500, marks=pytest.mark.soak)])
def test_unplugged_and_back(times: int, tmp_path: Path, proc: Any, figures: Callable[[str], None]) -> None:
    now_ns = 10**12
    by_id = tmp_path / "usb-autopilot"
    cable = Plug(by_id, lambda: now_ns)
    records: list[msgspec.Struct] = []
    connection = AutopilotConnection(
        TelemetryConfig(connection=f"serial:{by_id}:921600"), lambda: now_ns, records.append
    )

    def run(seconds: float, until: Callable[[], object] = lambda: False) -> float:
        nonlocal now_ns
        start_ns = now_ns
        while now_ns - start_ns < seconds * 1e9 and not until():
            now_ns += STEP_NS
            connection.poll()
            if cable.autopilot is not None:
                cable.autopilot.step()
        return (now_ns - start_ns) / 1e9

    def state() -> str:
        return connection.state

    def heartbeats() -> int:
        assert cable.autopilot is not None
        return sum(item.message.get_type() == "HEARTBEAT" for item in cable.autopilot.received)

    cable.plug()
    run(5.0, lambda: connection.state == "up")
    descriptors, slowest_s, up_s = 0, 0.0, 0.0
    for number in range(times):
        cable.unplug()
        run(UNPLUGGED_S[number % len(UNPLUGGED_S)])
        assert state() == "closed"
        cable.plug()
        slowest_s = max(slowest_s, run(HEARTBEAT_WITHIN_S, heartbeats))
        assert heartbeats(), f"no heartbeat within {HEARTBEAT_WITHIN_S} s of the node, number {number}"
        up_s = max(up_s, run(5.0, lambda: connection.state == "up"))
        assert state() == "up"
        if number == 1:
            gc.collect()  # what other tests have dropped is not ours to count
            descriptors = proc.open_descriptors()
    gc.collect()
    assert proc.open_descriptors() == descriptors
    with pytest.raises(LinkLost, match="in use by another program"):
        open_link(f"serial:{by_id}:921600")
    connection.close()
    cable.close()
    figures(
        f"{times} times, {len(set(cable.names))} names; heartbeat after {slowest_s:.2f} s at most, "
        f"up {up_s:.2f} s later; {descriptors} descriptors before and after"
    )
    assert len(set(cable.names)) >= 3


def test_a_udp_peer_that_goes_and_comes(figures: Callable[[str], None]) -> None:
    now_ns = 10**12
    address = f"127.0.0.1:{free_port()}"
    peer = open_link(f"udpin:{address}")

    def clock_ns() -> int:
        return now_ns

    connection = AutopilotConnection(TelemetryConfig(connection=f"udp:{address}", journal=""), clock_ns)

    def state() -> str:
        return connection.state

    for _ in range(20):
        autopilot = SimulatedAutopilot(peer, lambda _: STILL, clock_ns)
        for _ in range(300):
            now_ns += STEP_NS
            connection.poll()
            autopilot.step()
        assert state() == "up"
        peer.close()
        for _ in range(400):
            now_ns += STEP_NS
            connection.poll()
        assert state() == "waiting"
        peer = open_link(f"udpin:{address}")
    connection.close()
    peer.close()
    figures("20 times gone and back")
