"""What a camera saw on a recorded drive: its pictures, rendered where the vehicle truly was at each exposure."""

from __future__ import annotations

import sqlite3
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from edge.camera import Frame
from sim import Pose
from sim.trial.records import Array
from sim.trial.views import SimulatedCamera
from sim.world.camera import open_renderer
from sim.world.light import LIGHTS
from sim.world.scenario import Scenario, View
from sim.world.sensor import Sensor

if TYPE_CHECKING:
    from sim.research.trial.recorded_drive import RecordedDrive
    from sim.world.renderer import Renderer

NO_CARS_S = 1e6
"""Of a drive: the cars that came toward it have all passed."""
KEPT_EACH = 500
"""Scenes after which they are surely on the disk."""


class Scenes:
    """What is to be seen, before the sensor, from any pose on some roads: rendered once and kept in a file.

    Rendering takes two thirds of a replay, and a drive's scenes as PNG 100 MB. Close it in the end.
    """

    def __init__(self, path: Path) -> None:
        self._kept = sqlite3.connect(path)
        self._kept.execute("CREATE TABLE IF NOT EXISTS scenes (seen BLOB PRIMARY KEY, png BLOB) WITHOUT ROWID")
        self._renderers: dict[Scenario, Renderer] = {}
        self.rendered = 0
        """Scenes that were not kept yet."""

    def scene(self, scenario: Scenario, pose: Pose) -> NDArray[np.uint8]:
        """(H, W, 3) uint8 BGR."""
        seen = msgspec.msgpack.encode((scenario, pose.east_m, pose.north_m, pose.heading_deg))
        for (png,) in self._kept.execute("SELECT png FROM scenes WHERE seen = ?", (seen,)):
            return np.asarray(cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR), np.uint8)
        if scenario not in self._renderers:
            self._renderers[scenario] = open_renderer(scenario, scenario.drive())
        scene = self._renderers[scenario].render_scene(pose, NO_CARS_S)
        png = cv2.imencode(".png", scene, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes()
        self._kept.execute("INSERT INTO scenes VALUES (?, ?)", (seen, png))
        self.rendered += 1
        if self.rendered % KEPT_EACH == 0:
            self._kept.commit()
        return scene

    def close(self) -> None:
        """Keep what was rendered, and release the renderers."""
        self._kept.commit()
        self._kept.close()
        for renderer in self._renderers.values():
            renderer.close()


class FlightCamera(SimulatedCamera):
    """One camera of a recorded drive, the daemon's `Frames`: each exposure arrives when it did, rendered when taken."""

    def __init__(
        self, drive: RecordedDrive, exposures_s: Array, view: View, scenes: Scenes, now_ns: Callable[[], int]
    ) -> None:
        """exposures_s: (n,) of this run of the daemon."""
        self._drive, self._view, self._scenes, self._now_ns = drive, view, scenes, now_ns
        self._exposures_s = deque(enumerate(exposures_s.tolist()))
        self._sensors: dict[Scenario, Sensor] = {}

    def take(self, timeout_s: float) -> Frame | None:
        """The newest frame that has arrived since the last call; does not wait."""
        arrived = None
        while self._exposures_s and self._exposures_s[0][1] + self._drive.latency_s <= self._now_ns() / 1e9:
            arrived = self._exposures_s.popleft()
            self._delivered += 1
        if arrived is None:
            return None
        index, stamp_s = arrived
        return Frame(self.picture(stamp_s), round(stamp_s * 1e9), index)

    def picture(self, time_s: float) -> NDArray[np.uint8]:
        """What it saw at a time, (H, W, 3) uint8 BGR: other cars stand, and the sensor's noise and exposure go on."""
        drive, scenario = self._drive, self._drive.seen(time_s, self._view)
        if scenario not in self._sensors:
            light, size = LIGHTS[scenario.light], (scenario.width, scenario.height)
            self._sensors[scenario] = Sensor(light, scenario.view, size, scenario.fov_deg, scenario.drive_seed)
        east_m, north_m = drive.true_m(time_s).tolist()
        pose = Pose(east_m, north_m, drive.heading_deg(time_s), 0.0, 0.0)
        return self._sensors[scenario].develop(self._scenes.scene(scenario, pose), time_s)
