"""Plug-ins: guests of the daemon, opened where the config asks for them, and called at its moments.

A plug-in is a section of the config (`edge.config.Section`), which names a class like `Plugin`. No other is imported.
What it exchanges with the autopilot belongs to it as well, and goes with it: closed is gone.
"""

from __future__ import annotations

import logging
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.camera import Frame, Frames
from edge.camera.picture_check import PictureCheck
from edge.config import GROUP, Config, asked_sections, loaded
from edge.descriptor.network import Network
from edge.health.health import Health
from edge.health.monitor import StageTimes
from edge.journal.records import FrameUsed, PlaceFix, PluginFailed, Record
from edge.localization import PositionEstimator
from edge.recognition.recognizer import PlaceRecognizer
from edge.reference_map import MapSet, PartialMap
from edge.reference_map.place_records import PLACE
from edge.sequence import Correspondences, PlaceMatch
from edge.telemetry.autopilot import DRAIN_S, AutopilotConnection, Service
from edge.telemetry.codec import Message

if TYPE_CHECKING:
    from edge.keypoints.intrinsics import CameraDifference

T = TypeVar("T")
FAILURES = (Exception, SystemExit)
"""What a plug-in may raise without an effect on anything else; a person's Ctrl-C is none of its."""
log = logging.getLogger(__name__)


class RecognizerView:
    """What a plug-in may read of the recognizer, and no way to change what is recognized."""

    def __init__(self, recognizer: PlaceRecognizer) -> None:
        self._recognizer = recognizer
        self.config, self.model_name = recognizer.config, recognizer.model_name
        self.raw_of, self.describe = recognizer.raw_of, recognizer.describe

    @property
    def correspondences(self) -> Correspondences | None:
        """The points by which the newest frame shows a place; None where it does not, or was not verified."""
        return self._recognizer.matcher.correspondences

    @property
    def camera(self) -> CameraDifference | None:
        """What keypoints said of the vehicle's camera, once they are enough."""
        return self._recognizer.matcher.camera

    @property
    def map_set(self) -> MapSet:
        """As the recognizer has it."""
        return self._recognizer.map_set

    @property
    def is_in_line(self) -> bool:
        """As the recognizer has it."""
        return self._recognizer.is_in_line


@dataclass
class Parts:
    """What a plug-in may use of the daemon; the last three from `start` on.

    record: writes a record to the journal. times: of the stages of a frame. lost: records that the journal has lost.
    mapping_frames: instead of those of [mapping.camera].
    """

    config: Config
    clock_ns: Callable[[], int]
    record: Callable[[Record], object]
    autopilot: AutopilotConnection
    drive: PositionEstimator
    network: Network
    times: StageTimes
    health: Callable[[], Health]
    lost: Callable[[], int]
    plugins: Plugins
    mapping_frames: Frames | None = None
    recognizer: RecognizerView = field(init=False)
    pictures: PictureCheck = field(init=False)
    camera: Frames = field(init=False)


@dataclass(frozen=True)
class UsedFrame:
    """A frame that showed a new place, and what came of it.

    distance_m: driven when it was exposed. missed: places that were passed before it without a frame. record: as in the
    journal. place: as it was published; None where no event followed.
    """

    frame: Frame
    distance_m: float | None
    missed: int
    match: PlaceMatch | None
    record: FrameUsed
    place: PlaceFix | None


class Plugin:
    """Does nothing at any moment; a plug-in overrides those that it needs, and is made with its section and `Parts`.

    All calls come from the daemon's loop, and none may block: what takes longer belongs in a thread or a process.
    What is raised while the daemon starts, until the end of `start`, ends it; later, it ends the plug-in (`Plugins`).
    """

    service: Service | None = None
    """What it exchanges with the autopilot."""

    def newest_map(self) -> PartialMap | None:
        """A map of this drive, searched with the others: another object once it has grown. Asked before `start` too."""
        return None

    def start(self) -> None:
        """Everything is open: the recognizer, its maps, the camera."""

    def frame(self, frame: Frame) -> None:
        """A picture that shows something, also where it shows no new place; before its place is recognized.

        It is a copy that cannot be written to.
        """

    def frame_used(self, used: UsedFrame) -> None:
        """A frame was recognized, and is in the journal."""

    def turn(self, spare_s: float | None) -> None:
        """The end of each turn of the loop, 50 times a second.

        spare_s: waited for a frame, where no place was recognized in this turn; else None.
        """

    def end(self) -> None:
        """No further turn comes: begin to write what is left, side by side with the others. `close` follows."""

    def close(self) -> None:
        """The end, also where `start` was never called, and before the autopilot and the journal are closed."""


class Plugins:
    """Those that are open. One that fails is closed, and everything else goes on: a page must not cost a position."""

    def __init__(self, link: AutopilotConnection) -> None:
        """link: to the autopilot, with which their services exchange messages, and to the journal and the pilot."""
        self._open: dict[str, Plugin] = {}
        self._newest: PartialMap | None = None
        self._copied: tuple[Frame, Frame] | None = None
        self._link = link
        link.serve(self)

    def open(self, parts: Parts) -> None:
        """Open those that the config asks for; SetupError for one that cannot be."""
        for name, section in asked_sections(parts.config):
            kind = loaded(name, section.plugin, EntryPoint(name, section.plugin, GROUP).load)
            self._open[name] = loaded(name, section.plugin, partial(kind, section, parts))

    def start(self) -> None:
        """Once everything else is open; SetupError."""
        log.info("plug-ins: %s", ", ".join(self._open) or "none")
        for name, plugin in list(self._open.items()):
            loaded(name, type(plugin).__qualname__, plugin.start)

    def each(self, moment: Callable[[Plugin], object]) -> None:
        """Call each at a moment."""
        for name, plugin in list(self._open.items()):
            self._call(name, partial(moment, plugin))

    def show(self, frame: Frame) -> None:
        """Call each with a copy of a picture."""
        if self._open:
            self.each(lambda plugin: plugin.frame(self.copied(frame)))

    def copied(self, frame: Frame) -> Frame:
        """The frame with a copy of its picture in bytes, which numpy makes writable for nobody; made once."""
        if self._copied is None or self._copied[0] is not frame:
            image = np.frombuffer(frame.image.tobytes(), np.uint8).reshape(frame.image.shape)
            self._copied = frame, replace(frame, image=image)
        return self._copied[1]

    def ask(self, name: str, what: Callable[..., T]) -> T | None:
        """What a call of the plug-in of that name returns, for another one: it is the former that ends if it fails.

        None where it is not open, or fails.
        """
        return self._call(name, lambda: what(self._open[name]))

    def newest_map(self) -> PartialMap | None:
        """The map of this drive, None where nothing maps it."""
        newest = (self._call(name, partial(_checked_map, plugin)) for name, plugin in list(self._open.items()))
        self._newest = next((one for one in newest if one is not None), None)
        return self._newest

    def grown_maps(self, maps: MapSet) -> MapSet | None:
        """Some maps, with the map of this drive where it has grown since it was asked for last, else None."""
        for name, plugin in list(self._open.items()):
            newest = self._call(name, partial(_checked_map, plugin))
            if newest is not None and newest is not self._newest:
                self._newest = newest
                return self._call(name, partial(maps.with_newest, newest))
        return None

    def read(self, message: Message, now_ns: int, *, is_for_us: bool) -> list[Message]:
        """As `Service` has it, for those of all; what is due is sent here, since sending is where a wrong one fails."""
        self.each(partial(self._serve, lambda service: service.read(message, now_ns, is_for_us=is_for_us)))
        return []

    def due(self, now_ns: int) -> list[Message]:
        """The same."""
        self.each(partial(self._serve, lambda service: service.due(now_ns)))
        return []

    def abandon(self, now_ns: int) -> list[Message]:
        """Nothing: each said its last words when it was closed."""
        return []

    def close(self) -> None:
        """Close all, the last first; more than once is harmless."""
        self.each(lambda plugin: plugin.end())
        said = [self._end(name) for name in reversed(list(self._open))]
        if any(said):
            time.sleep(DRAIN_S)

    def _serve(self, exchange: Callable[[Service], list[Message]], plugin: Plugin) -> bool:
        """Send what its service has; whether that was anything."""
        messages = [] if plugin.service is None else exchange(plugin.service)
        if messages:
            self._link.send(messages)
        return bool(messages)

    def _call(self, name: str, call: Callable[[], T]) -> T | None:
        """What a call of a plug-in returns; None where it fails, and is closed, or was closed before."""
        try:
            return call() if name in self._open else None
        except FAILURES as error:
            self._end(name, error)
            return None

    def _end(self, name: str, error: BaseException | None = None) -> bool:
        """Close one, because of an error or at the end; whether it had last words for the autopilot."""
        plugin, has_said = self._open.pop(name), False
        now_ns = self._link.clock_ns()
        for step in (partial(self._serve, lambda service: service.abandon(now_ns), plugin), plugin.close):
            try:
                has_said = bool(step()) or has_said
            except FAILURES as another:
                error = error or another
        if error is not None:
            at = traceback.extract_tb(error.__traceback__)[-1]
            why = f"{type(error).__name__}: {error} ({Path(at.filename).name}:{at.lineno})"
            log.error("plug-in %s failed and is closed; everything else goes on: %s", name, why)
            log.debug("where it failed", exc_info=error)
            self._link.record(PluginFailed(name, why))
            self._link.status_text(f"Lookback: {name} failed, goes on without", mavlink.MAV_SEVERITY_WARNING)
        return has_said


def _checked_map(plugin: Plugin) -> PartialMap | None:
    """Its map of this drive; TypeError or ValueError for what is none."""
    newest = plugin.newest_map()
    if newest is not None and not isinstance(newest, PartialMap):
        raise TypeError(f"newest_map: {type(newest).__name__} is no map of a drive")
    if newest is not None and (newest.places.dtype, len(newest.places)) != (PLACE, newest.header.places):
        raise ValueError(f"newest_map: has other places than the {newest.header.places} of its header")
    return newest
