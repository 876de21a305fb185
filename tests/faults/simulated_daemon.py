"""A daemon in the test's own process, on a clock that the test moves."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from edge.camera import CameraHealth, Frame
from edge.config import load_config
from edge.daemon import Daemon
from edge.opened_parts import OpenedParts
from sim import Pose
from sim.vehicle.autopilot import SimulatedAutopilot
from sim.vehicle.pty_link import open_pty


class ScriptedFrames:
    """A camera whose time is the test's: what it shows and how it is are set from outside."""

    def __init__(self, clock_ns: Callable[[], int]) -> None:
        self._clock_ns = clock_ns
        self.health = CameraHealth("running", "", clock_ns())
        self.ended = False
        self.next: Frame | None = None

    def take(self, timeout_s: float) -> Frame | None:
        frame, self.next = self.next, None
        return frame

    def close(self) -> None:
        self.ended = True


class DaemonRig:
    """A daemon in this process, with its autopilot, on a clock that the test moves: 5 frames a second."""

    def __init__(self, config: Path, parts: ExitStack, network: Any, speed_mps: float, frames: Any) -> None:
        self.now_ns = 10**12
        self.number = 0
        self.cable = open_pty()
        parts.callback(self.cable.close)
        self.moves = self.autopilot_speaks = True
        self._speed_mps = speed_mps
        settings = load_config(config)
        telemetry = replace(settings.telemetry, connection=f"serial:{self.cable.device}:921600")
        self.frames = frames(self.clock_ns)
        self.autopilot = SimulatedAutopilot(self.cable, self._pose, self.clock_ns, gps=False)
        settings = replace(settings, telemetry=telemetry)
        self.daemon = Daemon(OpenedParts(settings, parts, self.clock_ns, frames=self.frames, network=network))

    def clock_ns(self) -> int:
        return self.now_ns

    def _pose(self, time_s: float) -> Pose:
        driven_m = self._speed_mps * (time_s - 1000.0)
        return Pose(0.0, driven_m, 0.0, self._speed_mps if self.moves else 0.0, driven_m)

    def step(self, image: NDArray[np.uint8] | None, index: int, turns: int = 2) -> None:
        """A fifth of a second with a picture at its beginning, or with none."""
        self.number = index
        for turn in range(turns):
            self.now_ns += 200_000_000 // turns
            if image is not None and turn == 0:
                self.frames.next = Frame(image, self.now_ns, index)
            if self.autopilot_speaks:
                self.autopilot.step()
            self.daemon.turn()
