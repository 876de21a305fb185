"""What is added to the daemon from outside: a plug-in is opened with the daemon's parts, and called at its moments.

All that it takes is a function `open_plugin(parts: OpenedParts) -> Plugin | None`: None where the config does not ask
for it. Those that come with Lookback are listed here; another package adds one by an entry point `lookback.plugins`.
"""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from edge.camera import Frame
from edge.errors import ConfigError
from edge.journal.records import FrameUsed, PlaceFix
from edge.reference_map import MapSoFar
from edge.sequence import PlaceMatch

GROUP = "lookback.plugins"
NAMES = "motion", "mapping", "layers", "recording", "home", "ros2", "page"
PLUGINS = [EntryPoint(name, f"edge_plugins.{name}.plugin:open_plugin", GROUP) for name in NAMES]
"""In the order in which they are opened and called. Names only: edge imports nothing of them."""
T = TypeVar("T")
log = logging.getLogger(__name__)


@dataclass(frozen=True)
class UsedFrame:
    """A frame that showed a new place, and what came of it.

    distance_m: driven when it was exposed. missed: places that were passed before it without a frame. record: as in the
    journal.
    """

    frame: Frame
    distance_m: float | None
    missed: int
    match: PlaceMatch | None
    record: FrameUsed


class Plugin:
    """Does nothing at any moment; a plug-in overrides those that it needs.

    All calls come from the daemon's loop, and none may block: what takes longer belongs in a thread or a process.
    What `open_plugin` and `start` raise ends the daemon; what another call raises ends the plug-in, see `Plugins`.
    """

    def newest_map(self) -> MapSoFar | None:
        """A map of this drive that is searched with the others: asked whenever the maps are opened."""
        return None

    def start(self) -> None:
        """Everything is open: the recognizer, its maps, the camera."""

    def frame(self, frame: Frame) -> None:
        """A picture that shows something, also where it shows no new place; before its place is recognized."""

    def spare_turn(self, waited_s: float, describe: Callable[[Frame], NDArray[np.float32]]) -> None:
        """A turn in which no place was recognized.

        waited_s: for a frame. describe: a frame -> its raw descriptor (R, D) float32.
        """

    def frame_used(self, used: UsedFrame) -> None:
        """A frame was recognized, and is in the journal."""

    def grown_map(self) -> MapSoFar | None:
        """`newest_map` where enough was added to it since; asked after each used frame."""
        return None

    def place(self, fix: PlaceFix) -> None:
        """A believed place was published."""

    def maps_changed(self) -> None:
        """Other maps are searched from now on, or more of the map of this drive."""

    def turn(self) -> None:
        """The end of each turn of the loop, 50 times a second."""

    def stop(self) -> None:
        """No further turn comes; everything is still open."""

    def close(self) -> None:
        """The end, also where `start` was never called; more than once is harmless."""


PluginKind = TypeVar("PluginKind", bound=Plugin)


class Plugins:
    """Those that are open. One that fails is closed, and everything else goes on: a page must not cost a position."""

    def __init__(self, failed: Callable[[str, str], object]) -> None:
        """failed: called with the name of a plug-in that failed, and why."""
        self._open: dict[str, Plugin] = {}
        self._failed = failed

    def open(self, parts: Any) -> None:
        """Open those that the config asks for; ConfigError for one that is not usable. parts: the daemon's."""
        loaded: dict[str, Any] = {}
        for point in (*PLUGINS, *entry_points(group=GROUP)):
            if point.name in loaded:
                raise ConfigError(f"plug-in {point.name} ({point.value}): another has this name; uninstall one of them")
            loaded[point.name] = _loaded(point)
        for name, open_plugin in loaded.items():
            plugin: Plugin | None = open_plugin(parts)
            if plugin is not None:
                self._open[name] = plugin

    def start(self) -> None:
        """Once everything else is open."""
        log.info("plug-ins: %s", ", ".join(self._open))
        for plugin in self._open.values():
            plugin.start()

    def find(self, kind: type[PluginKind]) -> PluginKind | None:
        """The plug-in of a class, for another one; None where it is not open."""
        return next((plugin for plugin in self._open.values() if isinstance(plugin, kind)), None)

    def each(self, moment: Callable[[Plugin], T]) -> list[T]:
        """Call each at a moment; what they return."""
        returned = []
        for name, plugin in list(self._open.items()):
            try:
                returned.append(moment(plugin))
            except Exception as error:
                log.exception("plug-in %s failed and is closed; everything else goes on", name)
                del self._open[name]
                with contextlib.suppress(Exception):
                    plugin.close()
                self._failed(name, f"{type(error).__name__}: {error}")
        return returned

    def close(self) -> None:
        """Close all, the last first."""
        with ExitStack() as stack:
            for plugin in self._open.values():
                stack.callback(plugin.close)


def _loaded(point: EntryPoint) -> Any:
    """Its `open_plugin`; ConfigError where an import fails, whatever the error."""
    try:
        return point.load()
    except Exception as error:
        why = " ".join(f"{type(error).__name__}: {error}".split())  # numpy's has many lines
        raise ConfigError(f"plug-in {point.name} ({point.value}): {why}; install or uninstall its package") from error
