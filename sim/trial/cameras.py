"""The cameras of a course: frames come late and with holes, and are described only where the daemon asks for it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import NamedTuple

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from edge.camera import CameraHealth, Frame
from edge.descriptor.network import Network
from sim.trial.views import RoadLibrary
from sim.world.scenario import Scenario

LATENCY_S = (0.03, 0.25)
HOLE_RATE, LONGEST_HOLE_S = 0.01, 1.5
"""Share of the frames at which a hole begins, as on a computer that is busy with something else."""


class View(NamedTuple):
    """What a camera sees: a road in some light, an arc length, meters left of the lane, degrees right of the lane."""

    scenario: Scenario
    route_m: float
    left_m: float
    turn_deg: float

    def of_rear(self) -> View:
        """What the rear camera sees there."""
        return self._replace(scenario=msgspec.structs.replace(self.scenario, view="rear"))


class PlacedNetwork(Network):
    """The network of a drive: it describes what the camera saw whose frame was taken last."""

    seen: View

    def __init__(self, library: RoadLibrary) -> None:
        """With the session of the library's network: to open another one takes 0.2 s."""
        vars(self).update(vars(library.network))
        self.library = library

    def describe(self, images: NDArray[np.uint8]) -> NDArray[np.float32]:
        """The descriptors of the view, whatever the images."""
        return self.library[self.seen.scenario].raw(*self.seen[1:])


class SimulatedCamera:
    """What all cameras have in common that are no devices; see `NewestFrame`."""

    _delivered = 0
    ended = False

    @property
    def health(self) -> CameraHealth:
        """See NewestFrame."""
        return CameraHealth("running", "", 0, delivered=self._delivered)

    def close(self) -> None:
        """See NewestFrame."""


class TrialCamera(SimulatedCamera):
    """One camera in simulated time: `expose` when it is due, `take` what has arrived."""

    def __init__(
        self,
        now_ns: Callable[[], int],
        rng: np.random.Generator,
        late_frames: int = 0,
        *,
        shown_m: Callable[[float], float] | None = None,
    ) -> None:
        """late_frames: by how many frames pictures are older than their stamps. shown_m: the arc length
        of the road that a picture shows, at that of the camera; None: they show none.
        """
        self._shown_m = shown_m
        self.network: PlacedNetwork | None = None
        """Describes the frames; without it none is delivered."""
        self._now_ns, self._rng = now_ns, rng
        self._hole_until_s = 0.0
        self._waiting: deque[tuple[float, int, View, int]] = deque()
        self._buffered: deque[tuple[View, int]] = deque(maxlen=late_frames + 1)
        self._picture = 0

    def expose(self, view: View, *, frozen: bool = False) -> None:
        """A frame of this view, or of the one before if it is frozen, unless there is a hole."""
        if not frozen or not self._buffered:
            self._picture += not self._buffered or self._buffered[-1][0] != view
            self._buffered.append((view, self._picture))
        (view, picture), now_s = self._buffered[0], self._now_ns() / 1e9
        if self._rng.random() < HOLE_RATE:
            self._hole_until_s = now_s + self._rng.uniform(0.0, LONGEST_HOLE_S)
        latency_s = self._rng.uniform(*LATENCY_S)
        if now_s >= self._hole_until_s:
            self._waiting.append((now_s + latency_s, self._now_ns(), view, picture))

    def take(self, timeout_s: float) -> Frame | None:
        """The newest frame that has arrived since the last call; does not wait."""
        arrived = None
        while self._waiting and self._waiting[0][0] <= self._now_ns() / 1e9:
            arrived = self._waiting.popleft()
        if arrived is None or self.network is None:
            return None
        self._delivered += 1
        self.network.seen = arrived[2]
        # Only so that it shows something, and is frozen only where the view is.
        coarse = np.random.default_rng(arrived[3]).integers(0, 255, (4, 4, 3), np.uint8)
        picture = np.asarray(cv2.resize(coarse, (64, 64), interpolation=cv2.INTER_LINEAR), np.uint8)
        if self._shown_m is not None:
            scenario, route_m, *offset = arrived[2]
            picture = self.network.library[scenario].picture(self._shown_m(route_m), *offset)
        return Frame(picture, arrived[1], self._delivered)
