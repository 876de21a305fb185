"""When a feed begins that a vehicle follows: with the vehicle."""

from __future__ import annotations

import time

from edge.camera.newest import NewestFrame
from edge.camera.recorded import RecordedCamera
from edge.config import CameraConfig
from edge.telemetry.autopilot import AutopilotConnection

SPEAKS_S, SETS_OFF_S, POLL_S = 3.0, 5.0, 0.02
"""How long to wait for a speed, and where the vehicle stands for it to set off. Heartbeats come each second, a speed
half a second after it is requested."""


def open_feed(config: CameraConfig, autopilot: AutopilotConnection) -> NewestFrame:
    """The feed, which begins when the vehicle sets off; where it was not seen to, with the first frame."""
    began_ns = await_departure(autopilot)
    return NewestFrame(lambda: RecordedCamera.of(config, began_ns), reopens=False, clock_ns=autopilot.clock_ns)


def await_departure(autopilot: AutopilotConnection) -> int | None:
    """When the vehicle set off, None where it was not seen to.

    The frames of a feed are chosen by the distance driven, and a feed waits for nobody. One that began by itself was
    0.8 s ahead on a busy machine, and its places 7 to 12 m off GPS.
    """
    motion, until_s, was_heard = autopilot.vehicle.motion, time.monotonic() + SPEAKS_S, False
    while time.monotonic() < until_s and motion.set_off_ns is None:
        autopilot.poll()
        speed_mps = motion.speed_mps(autopilot.clock_ns())
        if speed_mps is not None and not was_heard:
            was_heard, until_s = True, time.monotonic() + (0.0 if speed_mps else SETS_OFF_S)
        time.sleep(POLL_S)
    return motion.set_off_ns
