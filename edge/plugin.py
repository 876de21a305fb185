"""What is added to the daemon from outside: a plug-in is opened with the daemon's parts, and called at its moments.

A module `open_plugin(parts: OpenedParts) -> Plugin | None` is all that it takes: None where the config does not ask for
it. Those that come with Lookback are listed here; another package adds one by an entry point `lookback.plugins`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.camera import Frame
from edge.journal.records import FrameUsed, PlaceFix
from edge.reference_map import MapSoFar
from edge.sequence import PlaceMatch

GROUP = "lookback.plugins"
PLUGINS = {
    name: f"plugins.{name}.plugin:open_plugin"
    for name in ("motion", "mapping", "layers", "recording", "home", "ros2", "page")
}
"""As entry points, in the order in which they are opened and called. Names only: edge imports nothing of plugins."""


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

    All calls come from the daemon's loop, and none may block: what takes longer belongs in a thread or a process. An
    exception ends the daemon, and the service starts it again; SetupError, in `open_plugin` and `start`, does not.
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


def plugin_openers() -> Iterator[Callable[[Any], Plugin | None]]:
    """The function `open_plugin` of each plug-in that is installed."""
    for name, value in PLUGINS.items():
        yield EntryPoint(name, value, GROUP).load()
    for point in entry_points(group=GROUP):
        yield point.load()
