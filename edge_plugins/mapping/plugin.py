"""Live mapping in the daemon: which frames of which camera become places of the map of this drive, which is searched.

With a second camera ([mapping.camera]) its frames are chosen by [sampling] and described by the same network, in turns
of the daemon in which no frame of the first one is recognized, and only as often as that one leaves time. With one
camera, the frames that are recognized are mapped as well.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import replace

import numpy as np
from msgspec import UNSET
from numpy.typing import NDArray

from edge.camera import Frame, Frames
from edge.camera.checks import open_picture_check
from edge.camera.newest import NewestFrame
from edge.camera.picture_check import PictureCheck
from edge.feed.sampling import Sampler
from edge.health.monitor import notify
from edge.plugin import Parts, Plugin, UsedFrame
from edge.recognition.recognizer import model_key
from edge.reference_map import PartialMap, RegionsKey
from edge.telemetry.position_history import ExposureQueue
from edge_plugins.mapping import MappingConfig
from edge_plugins.mapping.drive_store import DriveStore
from edge_plugins.mapping.gps_consistency import GpsFreeDistance, GpsFreeOdometer
from edge_plugins.mapping.keypoint_rows import ASSUMED, ASSUMED_DEG, ASSUMED_FOCAL_SIGMA
from edge_plugins.mapping.live_map import LiveMap
from edge_plugins.mapping.place_log_records import LogHeader
from edge_plugins.mapping.status import MappingChanged, MappingStatus, MappingView

log = logging.getLogger(__name__)
START_LONGEST_S = 120.0  # of the service's unit, which the rest of the start may take
MappedFrame = tuple[Frame, NDArray[np.float32], float | None, int]
"""A frame at a new place, its raw descriptor (R, D), meters driven, and places passed before it without a frame."""
Describe = Callable[[Frame], NDArray[np.float32]]
"""A frame -> its raw descriptor (R, D)."""
LEAST_SHARE = 1 / 8
"""Share of the time in which the first camera is busy that the second one may use in any case, or it would starve."""


class MappingCamera:
    """A camera that maps: described only as often as the first one leaves time for it."""

    def __init__(self, parts: Parts, frames: Frames, pictures: PictureCheck) -> None:
        self.frames, self.pictures = frames, pictures
        self._vehicle, self._clock_ns = parts.autopilot.vehicle, parts.clock_ns
        self._sampler = Sampler(parts.config.sampling)
        self._takes_s = 0.0  # what its last frame took
        self._spare_s = 0.0  # saved for its next one
        self._asked_ns = self._clock_ns()

    def next_place(self, waited_s: float, describe: Describe) -> MappedFrame | None:
        """Its newest frame if that shows a new place and there is time for it; else None.

        waited_s: for a frame of the first camera, in this turn.
        """
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


class Mapping(Plugin):
    """[mapping]: the camera that maps, if it is one of its own, and the map of this drive."""

    def __init__(self, config: MappingConfig, parts: Parts) -> None:
        """SetupError for its camera."""
        self._parts = parts
        self._meters, velocity = GpsFreeOdometer(), parts.autopilot.vehicle.velocity
        with ExitStack() as opened:
            self._open(config, opened)
            opened.callback(setattr, velocity, "listen", velocity.listen)
            self._opened = opened.pop_all()
        velocity.listen = self._meters.hear
        self._awaiting: ExposureQueue[MappedFrame] = ExposureQueue(parts.autopilot.history)
        self._counted: ExposureQueue[GpsFreeDistance] = ExposureQueue(parts.autopilot.history)
        self._driven: GpsFreeDistance | None = None  # the newest of those
        self._gaps = parts.autopilot.vehicle.motion.gaps
        self._newest = self.live.searched.so_far()
        """Why a person has mapping pause; "" where nobody has."""
        self._told: tuple[str, str] = (self.status.state, self.status.why)

    def _open(self, mapping: MappingConfig, opened: ExitStack) -> None:
        config, camera, frames = self._parts.config, mapping.camera, self._parts.mapping_frames
        maps = config.camera if camera is UNSET else camera
        fov_deg, focal_sigma = (None if maps.fov_deg is UNSET else maps.fov_deg), 0.0
        if mapping.keypoints and fov_deg is None:
            fov_deg, focal_sigma = ASSUMED_DEG, ASSUMED_FOCAL_SIGMA
            log.warning("[%s] fov_deg: %s", "camera" if camera is UNSET else "mapping.camera", ASSUMED)
        header = LogHeader(model_key(self._parts.network), RegionsKey.of(config.descriptor), config.sampling)
        fov_deg = fov_deg if mapping.keypoints else None
        store = DriveStore(
            mapping,
            header,
            maps.view,
            before_long=_ask_for_time,
            fov_deg=fov_deg,
            lens=maps.alone,
            focal_sigma=focal_sigma,
        )
        keeps = config.camera.keep_pictures and maps.keep_pictures
        self.live = LiveMap(mapping, opened.enter_context(closing(store)), keeps_pictures=keeps)
        device: NewestFrame | None = None
        if camera is not UNSET and frames is None:
            frames = device = NewestFrame.configured(camera, self._parts.clock_ns)
        self._own: MappingCamera | None = None
        if frames is not None:
            opened.enter_context(closing(frames))
            kind = "" if camera is UNSET else camera.kind
            pictures = open_picture_check(device, kind, config.gates.min_speed_mps)
            self._own = MappingCamera(self._parts, frames, pictures)

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
        """The map of this drive, for people."""
        return self.live.searched.view(self.status)

    def driven_m(self) -> float | None:
        """How far the vehicle has driven by the odometer of the map of this drive; None where that is not known."""
        self._notice_gap()
        return self.live.driven_m(self._distance_m())

    def newest_map(self) -> PartialMap:
        """The part that lies far enough behind the vehicle to be searched."""
        return self._newest

    def frame_used(self, used: UsedFrame) -> None:
        """Map a frame that was recognized, unless another camera maps."""
        parts, frame = self._parts, used.frame
        raw = parts.recognizer.raw_of(frame.stamp_ns)
        if raw is not None and not parts.pictures.why_undated:
            if self._own is None:
                self._awaiting.add(frame.stamp_ns, (frame, raw, used.distance_m, used.missed))
            self._add_placed()
            self._newest = self.live.newly_searchable(self._distance_m()) or self._newest
        parts.times.lap("mapping")

    def turn(self, spare_s: float | None) -> None:
        """Map a frame of the second camera where there is time."""
        parts = self._parts
        if spare_s is not None:
            parts.times.start()
            found = self._own and self._own.next_place(spare_s, lambda frame: parts.recognizer.describe(frame.image))
            if found:
                self._awaiting.add(found[0].stamp_ns, found)
            self._add_placed()

    def end(self) -> None:
        """Map what waits for its position, and begin to write the last of it."""
        self._add_placed(at_the_end=True)
        self.live.store.end()

    def wait(self) -> None:
        """Until the threads have done what was handed over, for a simulation whose time passes faster than theirs."""
        self.live.store.keypoints.wait()

    def close(self) -> None:
        """Map what waits for its position, and close the camera and the file."""
        with self._opened:
            self._add_placed(at_the_end=True)

    def _add_placed(self, *, at_the_end: bool = False) -> None:
        """Add the frames to the map whose position is known by now, since it is interpolated; at_the_end: all."""
        autopilot = self._parts.autopilot
        newest = autopilot.history.newest
        if newest is not None:
            self.live.go_on(newest, autopilot.vehicle.motion.distance_m(newest.stamp_ns))
        own = self._meters.driven
        if own is not None and own != self._driven:
            self._driven = own
            self._counted.add(own.stamp_ns, own)
        for counted, position in self._counted.known(all_of_them=at_the_end):
            self.live.own.compare(counted, position)
        for (frame, raw, distance_m, missed), position in self._awaiting.known(all_of_them=at_the_end):
            self._notice_gap()
            self.live.add(raw, frame.image, position, distance_m, autopilot.gps_fault, missed)
        status = self.status
        if (status.state, status.why) != self._told:
            self._told = status.state, status.why
            self._parts.record(MappingChanged(status.state, status.why, status.name, status.places))
            words = f"mapping, {status.places} places" if status.state == "mapping" else f"not mapping: {status.why}"
            autopilot.status_text(f"Lookback {words}"[:50])

    def _distance_m(self) -> float | None:
        return self._parts.autopilot.vehicle.motion.distance_m(self._parts.clock_ns())

    def _notice_gap(self) -> None:
        gaps = self._parts.autopilot.vehicle.motion.gaps
        if self._gaps != gaps:
            self._gaps = gaps
            self.live.interrupt()


def _ask_for_time(seconds: float) -> None:
    """Ask systemd to wait for the start: what was mapped before may be a long drive."""
    notify(f"EXTEND_TIMEOUT_USEC={round((START_LONGEST_S + seconds) * 1e6)}")
