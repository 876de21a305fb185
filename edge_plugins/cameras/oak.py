"""A Luxonis OAK camera through DepthAI 3 (extra `oak`).

The OAK scales and converts on the device, so that frames arrive as BGR in the requested size.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from datetime import timedelta
from types import ModuleType
from typing import TYPE_CHECKING, cast

import numpy as np

from edge.camera.frame import Setting, differences
from edge.config import CameraConfig
from edge.errors import CameraLost, ConfigError
from edge.extras import import_extra
from edge.feed import Frame

if TYPE_CHECKING:
    import depthai as dai

FIRST_FRAME_TIMEOUT_S = 10.0  # an OAK boots its firmware over USB when it is opened


@dataclass(frozen=True)
class OakSource:
    """A pipeline that is ready to start, and its output of BGR888i frames.

    device: None for a pipeline that replays a file on the host. Its end is the end of a feed; a device whose stream
    ends is lost.
    """

    pipeline: dai.Pipeline
    output: dai.Node.Output
    name: str
    device: dai.Device | None = None


class OakCamera:
    """Starts a pipeline and returns its newest frame, with the device's timestamp synchronized to ours by DepthAI."""

    def __init__(self, config: CameraConfig, build: Callable[[CameraConfig], OakSource] | None = None) -> None:
        """Open the OAK with the device ID `config.device`, or the first one found if that is "", and wait for a frame.

        build: makes the pipeline; by default one on a device. Raises ConfigError if DepthAI is not installed, and
        CameraLost if there is no such device or it gives no frame.
        """
        self._dai = import_depthai()
        self._source = (build or device_source)(config)
        self._stall_timeout_s = self.read_timeout_s = config.stall_timeout_s
        try:
            # A queue of one frame, not blocking: the device never waits for us, and we never get an old frame.
            self._queue = self._source.output.createOutputQueue(maxSize=1, blocking=False)
            self._source.pipeline.start()
            self._first = self._next(FIRST_FRAME_TIMEOUT_S)
        except CameraLost:
            self.close()
            raise
        except RuntimeError as error:
            self.close()
            raise CameraLost(f"{self._source.name}: cannot start: {_one_line(error)}") from None
        self.differences = frame_differences(config, self._first) if self._first else ()

    def read(self) -> Frame | None:
        """Block until the next frame, at most `stall_timeout_s`; None only at the end of a replayed file."""
        message, self._first = self._first or self._next(self._stall_timeout_s), None
        if message is None:
            return None
        image = np.ascontiguousarray(message.getCvFrame(), dtype=np.uint8)
        stamp_ns = message.getTimestamp() // timedelta(microseconds=1) * 1000
        return Frame(image, stamp_ns, message.getSequenceNum())

    def _next(self, timeout_s: float) -> dai.ImgFrame | None:
        # With a timeout, because a lost device does not always end its queue.
        try:
            message = cast("dai.ImgFrame | None", self._queue.get(timedelta(seconds=timeout_s)))
        except self._dai.MessageQueue.QueueException:
            if self._source.device is None:
                return None
            raise CameraLost(f"{self._source.name}: the device stopped; is it unplugged?") from None
        except RuntimeError as error:  # XLinkError is one
            raise CameraLost(f"{self._source.name}: {_one_line(error)}") from None
        if message is None:
            raise CameraLost(f"{self._source.name}: no frame for {timeout_s:g} s")
        return message

    def close(self) -> None:
        """Stop the pipeline and release the device; more than once is harmless."""
        self._source.pipeline.stop()
        self._source.pipeline.wait()
        if self._source.device is not None:
            self._source.device.close()


def import_depthai() -> ModuleType:
    """DepthAI, which is loaded only here: 100 MB that a vehicle without an OAK does not need.

    Raises ConfigError that names the extra to install.
    """
    # Unless turned off before the import, it sends usage data to its vendor, writes files for that, and installs its
    # own signal handlers (with which SIGXFSZ kills the process; Python turns it into an OSError).
    os.environ.setdefault("DEPTHAI_TELEMETRY", "0")
    os.environ.setdefault("DEPTHAI_INSTALL_SIGNAL_HANDLER", "0")
    return import_extra("depthai", "oak", "[camera] kind: oak needs DepthAI")


def device_source(config: CameraConfig) -> OakSource:
    """A pipeline on an OAK: its color camera (socket A), scaled and converted on the device."""
    import depthai as dai

    info = _find_device(config.device)
    name = f"OAK {info.deviceId}"
    try:
        device = dai.Device(info)
        # DepthAI would reconnect silently and forever; here the camera's thread reconnects, and reports it.
        device.setMaxReconnectionAttempts(0)
        pipeline = dai.Pipeline(device)
        pipeline.setStopOnDeviceLoss(True)
        camera = pipeline.create(dai.node.Camera).build(dai.CameraBoardSocket.CAM_A)
        output = camera.requestOutput((config.width, config.height), dai.ImgFrame.Type.BGR888i, fps=config.fps)
    except RuntimeError as error:
        raise CameraLost(f"{name}: cannot open it: {_one_line(error)}") from None
    return OakSource(pipeline, output, name, device)


def _find_device(device_id: str) -> dai.DeviceInfo:
    """Search once, for half a second: `dai.Device()` would search for ten."""
    import depthai as dai

    if device_id.startswith("/dev/"):
        raise ConfigError(f'[camera] device: {device_id} is not an OAK device ID; write "" for the first OAK found')
    found = dai.Device.getAllAvailableDevices()
    for info in found:
        if device_id in {"", info.deviceId, info.name}:
            return info
    others = f"; found: {', '.join(info.deviceId for info in found)}" if found else ""
    raise CameraLost(
        f"OAK {device_id or 'camera'}: not found; is it plugged in, and are the udev rules installed?{others}"
    )


def frame_differences(config: CameraConfig, frame: dai.ImgFrame) -> tuple[str, ...]:
    """One line for each difference of the first frame's size and rate from the config."""
    given: dict[str, Setting] = {"width": frame.getWidth(), "height": frame.getHeight()}
    if frame.getFps() > 0:  # unknown for replayed frames
        given["fps"] = frame.getFps()
    return differences({"width": config.width, "height": config.height, "fps": config.fps}, given)


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
