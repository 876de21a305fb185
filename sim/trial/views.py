"""What a camera sees of a road, as descriptors: rendered and described once for each cell of the road, then kept.

A cell is a meter along the road, a meter across it and 2 degrees of heading, or `cell_m` times as much of each, so that
many drives share the minutes that rendering and the network cost. The recognizer itself matches these descriptors as on
a vehicle. Frames of a camera come late and with holes, and are described only where the daemon asks for it.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray

from edge.config import DescriptorConfig
from edge.descriptor.network import Network, pictures_for
from edge.files import replacing
from edge.keypoints import Keypoints
from sim import Pose
from sim.world.camera import open_renderer
from sim.world.drive import WorldDrive
from sim.world.scenario import Scenario

if TYPE_CHECKING:
    from sim.world.renderer import Renderer
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

import cv2

from edge.camera import CameraHealth, Frame

CELL_DEG = 2.0
MOST_LEFT_M = 60
"""Beside the lane: as far as an autopilot went that steered by a spoofed GPS, in a recorded drive."""
Cell: TypeAlias = tuple[int, int, int]


class RoadViews:
    """One camera on one road, in one light; close it in the end."""

    def __init__(self, scenario: Scenario, network: Network, folder: Path, cell_m: int) -> None:
        """folder: where descriptors are kept, one file for each scenario."""
        self._cell_m = cell_m
        self.drive: WorldDrive = scenario.drive()
        self._scenario, self._network = scenario, network
        self._renderer: Renderer | None = None
        self.keypoints: dict[tuple[float, float], Keypoints] = {}
        """Of pictures of the map's drive, by `picture`'s arguments, for whoever finds them."""
        keys = ("seed", "length_m", "light", "view", "direction", "drive_seed")
        known_by = [network.info.sha256[:12], *(f"{getattr(scenario, key):}" for key in keys)]
        mounted = scenario.camera_down_deg, scenario.camera_right_deg
        known_by += [f"{one:g}" for one in mounted if any(mounted)]
        self._path = folder / f"{'_'.join(known_by)}.npz"
        self._known: dict[Cell, NDArray[np.float16]] = {}
        if self._path.exists():
            with np.load(self._path) as kept:
                self._known = dict(zip(map(tuple, kept["cells"].tolist()), kept["raw"], strict=True))
        self._kept = len(self._known)

    def raw(self, route_m: float, left_m: float = 0.0, turn_deg: float = 0.0) -> NDArray[np.float32]:
        """Raw descriptors (R, D) at an arc length, beside the lane, looking so far to the right of the lane."""
        size_m = self._cell_m
        turns = size_m * round(((turn_deg + 180.0) % 360.0 - 180.0) / (size_m * CELL_DEG))
        along_m, lateral_m = (size_m * round(at_m / size_m) for at_m in (route_m, left_m))
        cell = along_m, min(max(lateral_m, -MOST_LEFT_M), MOST_LEFT_M), turns
        if cell not in self._known:
            self._known[cell] = self._describe(*cell).astype(np.float16)
        return self._known[cell].astype(np.float32)

    def _describe(self, route_m: int, left_m: int, turns: int) -> NDArray[np.float32]:
        image, config, info = self.picture(route_m, left_m, turns * CELL_DEG), DescriptorConfig(), self._network.info
        return Network.describe(self._network, pictures_for(info, image, "left-right", config.region_width))

    def picture(self, route_m: float, left_m: float = 0.0, turn_deg: float = 0.0) -> NDArray[np.uint8]:
        """The camera's picture there, (H, W, 3) uint8 BGR."""
        if self._renderer is None:
            self._renderer = open_renderer(self._scenario, self.drive)
        sign = 1.0 if self.drive.direction == "forward" else -1.0
        east_m, north_m, heading_rad = self.drive.route.at(route_m, sign * (self.drive.lane_m + left_m))
        heading_deg = np.degrees(heading_rad) + (0.0 if sign > 0 else 180.0) + turn_deg
        # Cars are where they are on a drive at the middle of the lane.
        covered_m = route_m if sign > 0 else self.drive.route.length_m - route_m
        time_s = self.drive.time_at_s(covered_m)
        return self._renderer.render(Pose(east_m, north_m, float(heading_deg) % 360.0, 0.0, covered_m), time_s)

    def save(self) -> None:
        """Keep on disk what was described."""
        if len(self._known) > self._kept:
            self._kept = len(self._known)
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with replacing(self._path) as file:
                np.savez(file, cells=np.array(list(self._known)), raw=np.stack(list(self._known.values())))

    def close(self) -> None:
        """Release the renderer."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None


class RoadLibrary:
    """The views of all roads that were asked for."""

    def __init__(self, network: Network, folder: Path, cell_m: int = 1) -> None:
        """folder: of one `cell_m`, how far apart views are."""
        self.network = network
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self._cell_m = folder, cell_m
        self._views: dict[bytes, RoadViews] = {}

    def __getitem__(self, scenario: Scenario) -> RoadViews:
        """The views of a scenario."""
        key = msgspec.msgpack.encode(scenario)
        if key not in self._views:
            self._views[key] = RoadViews(scenario, self.network, self.folder, self._cell_m)
        return self._views[key]

    def save(self) -> None:
        """See RoadViews."""
        for views in self._views.values():
            views.save()

    def close(self) -> None:
        """See RoadViews."""
        for views in self._views.values():
            views.close()


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
