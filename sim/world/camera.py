"""The simulator as a camera: `[camera] kind = "sim"`, whose device is the path of a scenario file."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from edge.camera import Camera, Frame
from edge.config import CameraConfig
from sim.output import needing
from sim.world.drive import WorldDrive
from sim.world.route import generate_route
from sim.world.scenario import Scenario, load_scenario

if TYPE_CHECKING:
    from sim.world.renderer import Renderer
    from sim.world.street import World


def open_camera(config: CameraConfig) -> Camera:
    """The entry point of `lookback.cameras`. ConfigError when the scenario is wrong or Panda3D is not installed."""
    return SimCamera(load_scenario(Path(config.device)), config)


def open_renderer(scenario: Scenario, drive: WorldDrive) -> Renderer:
    """The scenario's camera in its world; takes about two seconds a kilometer."""
    # Imported here: positions alone need no renderer.
    with needing("the simulator", "sim"):
        from sim.world.renderer import Renderer
    from sim.world.light import LIGHTS
    from sim.world.traffic import build_traffic

    return Renderer(
        _world_of(scenario.seed, scenario.length_m, scenario.repeats_m),
        build_traffic(drive, scenario.car_ahead_m),
        LIGHTS[scenario.light],
        view=scenario.view,
        size=(scenario.width, scenario.height),
        fov_deg=scenario.fov_deg,
        seed=scenario.drive_seed,
        mounted_deg=(scenario.camera_down_deg, scenario.camera_right_deg),
    )


@lru_cache(maxsize=1)
def _world_of(seed: int, length_m: float, repeats_m: float) -> World:
    """The world of the newest road: a map and the drive on it need the same, which takes half of `open_renderer`."""
    from sim.world.street import build_world

    return build_world(generate_route(seed, length_m, repeats_m))


EXPOSED = (-0.5, -0.25, 0.0, 0.25, 0.5)  # shares of an exposure at which the scene is rendered
BANDS = 8  # of rows that are exposed together, where a sensor reads them one after another


def picture(renderer: Renderer, scenario: Scenario, drive: WorldDrive, time_s: float) -> NDArray[np.uint8]:
    """What the scenario's camera sees, (H, W, 3) uint8 BGR; time_s: of the drive, when its middle row is exposed."""
    moments = EXPOSED if scenario.exposure_s else (0.0,)
    bands = BANDS if scenario.readout_s else 1
    rows = np.linspace(0, scenario.height, bands + 1).astype(int)
    scene = np.empty((scenario.height, scenario.width, 3), np.uint8)
    for band, (first, end) in enumerate(pairwise(rows)):
        middle_s = time_s + ((band + 0.5) / bands - 0.5) * scenario.readout_s
        poses = [drive.pose(middle_s + share * scenario.exposure_s, scenario.camera_ahead_m) for share in moments]
        scene[first:end] = np.mean([renderer.render_scene(pose, time_s)[first:end] for pose in poses], axis=0)
    return renderer.develop(scene, time_s)


RENDER_S = 5.0  # a picture on a busy computer


class SimCamera:
    """Renders the view of the scenario's camera now; the vehicle stands at the start until the scenario's epoch.

    Use it from one thread: the one that opens it.
    """

    def __init__(
        self,
        scenario: Scenario,
        config: CameraConfig,
        clock_ns: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[float], object] = time.sleep,
    ) -> None:
        self.differences = tuple(
            f"{key}: asked for {getattr(config, key)}, the scenario gives {getattr(scenario, key)}"
            for key in ("width", "height")
            if getattr(config, key) != getattr(scenario, key)
        )
        self.read_timeout_s = RENDER_S + 1 / config.fps
        self._drive = scenario.drive()
        self._scenario = scenario
        self._renderer: Renderer | None = open_renderer(scenario, self._drive)
        self._clock_ns = clock_ns
        self._sleep = sleep
        self._period_ns = round(1e9 / config.fps)
        self._opened_ns = clock_ns()
        self._epoch_ns = self._opened_ns if scenario.epoch_ns is None else scenario.epoch_ns
        self._next = 0

    def read(self) -> Frame | None:
        """The next picture, paced by fps; None after the drive's end. Blocks for one frame period at most.

        A reader that is late gets the newest picture, and the index shows how many it missed.
        """
        if self._renderer is None:
            return None
        now_ns = self._clock_ns()
        index = max(self._next, (now_ns - self._opened_ns) // self._period_ns)
        stamp_ns = self._opened_ns + index * self._period_ns
        time_s = (stamp_ns - self._epoch_ns) / 1e9
        if time_s > self._drive.duration_s:
            return None
        if stamp_ns > now_ns:
            self._sleep((stamp_ns - now_ns) / 1e9)
        self._next = index + 1
        return Frame(picture(self._renderer, self._scenario, self._drive, time_s), stamp_ns, index)

    def close(self) -> None:
        """Release the renderer; a later read() returns None."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
