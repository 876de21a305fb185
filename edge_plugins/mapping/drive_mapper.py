"""Live mapping for the daemon: which frames of which camera become places of the map of this drive.

With a second camera ([mapping.camera]) its frames are chosen by [sampling] and described by the same network, in turns
of the daemon in which no frame of the first one is recognized, and only as often as that one leaves time. With one
camera, the frames that are recognized are mapped as well.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import replace
from functools import partial

import numpy as np
from msgspec import UNSET
from numpy.typing import NDArray

from edge.camera import Frame, Frames
from edge.camera.newest import NewestFrame
from edge.camera.picture_check import PictureCheck
from edge.config import Config
from edge.feed.sampling import Sampler
from edge.geodesy import VehiclePosition
from edge.health.monitor import notify
from edge.journal.records import MappingChanged, Record
from edge.reference_map import MapSoFar, ModelKey, RegionsKey
from edge.telemetry.autopilot import AutopilotConnection
from edge.telemetry.vehicle import Vehicle
from edge_plugins.mapping import LiveMap, LogHeader, MappingStatus, MappingView

START_S = 120.0  # of the service's unit, which the rest of the start may take
MappedFrame = tuple[Frame, NDArray[np.float32], float | None, int]
"""A frame at a new place, its raw descriptor (R, D), meters driven, and places passed before it without a frame."""
Describe = Callable[[Frame], NDArray[np.float32]]
"""A frame -> its raw descriptor (R, D)."""
LEAST_SHARE = 1 / 8
"""Share of the time in which the first camera is busy that the second one may use in any case, or it would starve."""


class OwnCamera:
    """A camera that maps: described only as often as the first one leaves time for it."""

    def __init__(
        self, config: Config, frames: Frames, device: NewestFrame | None, vehicle: Vehicle, clock_ns: Callable[[], int]
    ) -> None:
        """device: opens it again; None where it cannot be."""
        self.frames, self._vehicle, self._clock_ns = frames, vehicle, clock_ns
        self._sampler = Sampler(config.sampling)
        kind = "" if config.mapping.camera is UNSET else config.mapping.camera.kind
        self.pictures = PictureCheck(device, kind, config.gates.min_speed_mps)
        self._takes_s = 0.0  # what its last frame took
        self._spare_s = 0.0  # saved for its next one
        self._asked_ns = clock_ns()

    def next_place(self, waited_s: float, describe: Describe) -> MappedFrame | None:
        """Its newest frame if that shows a new place and there is time for it, see `DriveMapper.map_next`."""
        now_ns = self._clock_ns()
        busy_s, self._asked_ns = (now_ns - self._asked_ns) / 1e9 - waited_s, now_ns
        self._spare_s = min(self._takes_s, self._spare_s + waited_s + LEAST_SHARE * max(0.0, busy_s))
        frame = self.frames.take(0.0) if self._spare_s >= self._takes_s else None
        if frame is None:
            return None
        speed_mps = self._vehicle.motion.speed_mps(now_ns)
        frame = self.pictures.dated(frame, speed_mps, self._vehicle.position(now_ns))
        if not self.pictures.is_usable(frame, speed_mps) or self.pictures.why_undated:
            return None
        distance_m = self._vehicle.motion.distance_m(frame.stamp_ns)
        if distance_m is None or not self._sampler.is_place(frame.stamp_ns, distance_m):
            return None
        raw = describe(frame)
        self._asked_ns = self._clock_ns()
        self._spare_s, self._takes_s = 0.0, (self._asked_ns - now_ns) / 1e9
        return frame, raw, distance_m, self._sampler.missed


class DriveMapper:
    """The camera that maps, if it is one of its own, and the map of this drive."""

    def __init__(
        self,
        config: Config,
        model: ModelKey,
        parts: ExitStack,
        autopilot: AutopilotConnection,
        record: Callable[[Record], object],
        clock_ns: Callable[[], int] = time.monotonic_ns,
        *,
        frames: Frames | None = None,
    ) -> None:
        """Open the camera and the file; SetupError for the camera. `parts` closes them. frames: of that camera."""
        self._autopilot, self._record, self._clock_ns = autopilot, record, clock_ns
        self._line_m = config.sequence_frames * config.sampling.spacing_m
        self._drift = config.gates.drift_percent / 100
        camera = config.mapping.camera
        view = config.camera.view if camera is UNSET else camera.view
        header = LogHeader(model, RegionsKey.of(config.descriptor), config.sampling)
        self.live = parts.enter_context(closing(LiveMap(config.mapping, header, view, before_long=_ask_for_time)))
        device: NewestFrame | None = None
        if camera is not UNSET and frames is None:
            frames = device = NewestFrame.configured(camera, clock_ns)
        self._own: OwnCamera | None = None
        if frames is not None:
            parts.enter_context(closing(frames))
            self._own = OwnCamera(config, frames, device, autopilot.vehicle, clock_ns)
        self._gaps = autopilot.vehicle.motion.gaps
        self.paused = ""
        """Why a person has mapping pause; "" where nobody has."""
        self._told: tuple[str, str] = (self.status.state, self.status.why)

    @property
    def status(self) -> MappingStatus:
        """What is mapped now, for people."""
        own, status = self._own, self.live.status
        if own is not None and own.frames.health.state == "lost":
            return replace(status, state="waiting", why=f"camera: {own.frames.health.reason}")
        if own is not None and own.pictures.why_undated:
            return replace(status, state="waiting", why=own.pictures.why_undated)
        return status

    def view(self) -> MappingView:
        """The map of this drive, and what to expect of it, for people."""
        return replace(self.live.view(self._line_m, self._drift), status=self.status)

    def driven_m(self) -> float | None:
        """How far the vehicle has driven by the odometer of the map of this drive; None where that is not known."""
        self._notice_gap()
        return self.live.driven_m(self._autopilot.vehicle.motion.distance_m(self._clock_ns()))

    def map_recognized(
        self, frame: Frame, raw: NDArray[np.float32], distance_m: float | None, missed: int
    ) -> MapSoFar | None:
        """Map a frame that was recognized, at a new place, unless another camera maps.

        missed: places that were passed before it without a frame.

        The map of this drive, if enough further places lie far enough behind the vehicle to be searched.
        """
        if self._own is None:
            self._await_position(frame, raw, distance_m, missed)
        self.add_placed()
        return self.live.newly_searchable(self._autopilot.vehicle.motion.distance_m(self._clock_ns()))

    def map_next(self, waited_s: float, describe: Describe) -> None:
        """Map the newest frame of the second camera, if it shows a new place and the first camera left time for it.

        waited_s: for a frame of the first camera, in this turn.
        """
        found = self._own.next_place(waited_s, describe) if self._own is not None else None
        if found is not None:
            self._await_position(*found)
        self.add_placed()

    def add_placed(self) -> None:
        """Add the frames to the map whose position is known by now, since it is interpolated."""
        history = self._autopilot.history
        if history.newest is not None:
            self.live.go_on(history.newest, self._autopilot.vehicle.motion.distance_m(history.newest.stamp_ns))
        history.release()
        self._publish_change()

    def _await_position(self, frame: Frame, raw: NDArray[np.float32], distance_m: float | None, missed: int) -> None:
        self._autopilot.history.when_known(frame.stamp_ns, partial(self._add, raw, frame.image, distance_m, missed))

    def _add(
        self,
        raw: NDArray[np.float32],
        image: NDArray[np.uint8],
        distance_m: float | None,
        missed: int,
        position: VehiclePosition | None,
    ) -> None:
        self._notice_gap()
        self.live.add(raw, image, position, distance_m, self.paused or self._autopilot.gps_fault, missed)

    def _notice_gap(self) -> None:
        if self._gaps != self._autopilot.vehicle.motion.gaps:
            self._gaps = self._autopilot.vehicle.motion.gaps
            self.live.interrupt()

    def _publish_change(self) -> None:
        status = self.status
        if (status.state, status.why) != self._told:
            self._told = status.state, status.why
            self._record(MappingChanged(status.state, status.why, status.name, status.places))
            words = f"mapping, {status.places} places" if status.state == "mapping" else f"not mapping: {status.why}"
            self._autopilot.status_text(f"Lookback {words}"[:50])


def _ask_for_time(seconds: float) -> None:
    """Ask systemd to wait for the start: what was mapped before may be a long drive."""
    notify(f"EXTEND_TIMEOUT_USEC={round((START_S + seconds) * 1e6)}")
