"""Renders the recordings anew: `python -m tests.golden.record`. Everything is seeded; needs the extra `sim`.

A picture differs in a few bits with another OpenGL driver, so build the goldens anew afterwards (README.md).
"""

from __future__ import annotations

import shutil
import struct
import tempfile
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2

from edge.descriptor.network import Network
from edge.feed import FeedHeader
from edge.feed.writer import FeedWriter
from sim.vehicle.autopilot import SimulatedAutopilot
from sim.vehicle.pty_link import Cable
from sim.world.camera import open_renderer
from sim.world.drive import WorldDrive
from sim.world.recording import row_of
from sim.world.scenario import Scenario
from tests.golden.harness import RECORDINGS, START_NS, TELEMETRY, PlayedFrames, cases, load_case, run_daemon

LENGTH_M = 340.0
SPACING_M = 2.0
HALT_PERIOD_S = 0.5
JPEG_QUALITY = 75
AWAY_M = 3000.0
"""How far north of its world the drive `elsewhere` claims to be."""


@dataclass(frozen=True)
class Taken:
    """A drive, the stretches [start, end) of it in meters driven that are kept, and a shift of its positions."""

    scenario: Scenario
    kept_m: tuple[tuple[float, float], ...]
    north_m: float = 0.0


def _scenario(seed: int = 1, **keys: object) -> Scenario:
    return Scenario(seed=seed, length_m=LENGTH_M, width=160, height=120, speed_mps=6.0, **keys)  # type: ignore[arg-type]


OUT = _scenario(view="rear", drive_seed=1)
HOME = _scenario(light="night", direction="reverse", drive_seed=2, stops=1)
AGAIN = _scenario(light="dusk", drive_seed=3, stops=1)
GPS_FAILS_S = START_NS / 1e9 + 8.0
AUTOPILOTS: dict[str, dict[str, Any]] = {
    "home_with_resets": {"firmware": "ardupilot", "gps_fails_s": GPS_FAILS_S},
    "home_without_gps": {"firmware": "ardupilot", "gps": False, "has_origin": False},
    "again_with_sensor": {"firmware": "px4", "gps_fails_s": GPS_FAILS_S},
}
"""The simulated autopilot of each run whose telemetry is recorded."""
DRIFT_PERCENT = 3.0

# The stretch from 130 to 170 m is on no map; short and long gaps in the queries are frames that never came.
RECORDED: dict[str, Taken] = {
    "out_first": Taken(OUT, ((0.0, 130.0),)),
    "out_second": Taken(OUT, ((170.0, LENGTH_M),)),
    "elsewhere": Taken(_scenario(seed=5, view="rear", drive_seed=4), ((40.0, 120.0),), AWAY_M),
    "home_night": Taken(HOME, ((0.0, 100.0), (107.0, 225.0), (244.0, LENGTH_M))),
    "again_dusk": Taken(AGAIN, ((0.0, 60.0), (63.0, LENGTH_M))),
}


def frame_times_s(drive: WorldDrive) -> Iterator[float]:
    """A time each SPACING_M, and one each HALT_PERIOD_S while the vehicle stands between start and end."""
    due_m, last_s = 0.0, -HALT_PERIOD_S
    for time_s, covered_m in zip(drive.times_s.tolist(), drive.distances_m.tolist(), strict=True):
        stands = 0.0 < covered_m < drive.route.length_m and drive.pose(time_s).speed_mps < 0.05
        if covered_m >= due_m:
            due_m, last_s = due_m + SPACING_M, drive.time_at_s(due_m)
            yield last_s
        elif stands and time_s - last_s >= HALT_PERIOD_S:
            last_s = time_s
            yield time_s


def record(name: str, recording: Taken) -> None:
    """Render one recording into its folder, which is replaced."""
    scenario, drive = recording.scenario, recording.scenario.drive()
    shutil.rmtree(RECORDINGS / name, ignore_errors=True)
    source = f"simulated, seed {scenario.seed}, {scenario.light}, {scenario.direction}, drive {scenario.drive_seed}"
    header = FeedHeader(name, scenario.view, scenario.width, scenario.height, source=source)
    renderer = open_renderer(scenario, drive)
    try:
        with FeedWriter(RECORDINGS / name, header) as writer:
            for time_s in frame_times_s(drive):
                if any(start <= drive.distance_m(time_s) < end for start, end in recording.kept_m):
                    image = renderer.render(drive.pose(time_s), time_s)
                    jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()
                    row = row_of(drive, time_s)
                    lat_deg = (row.lat_deg or 0.0) + recording.north_m / 110_800
                    writer.write(jpeg, replace(row, lat_deg=lat_deg, extra={}))
    finally:
        renderer.close()


class RecordingCable(Cable):
    """Keeps what the autopilot sends, as a .tlog: microseconds since the start, big-endian, before each frame."""

    now_ns = START_NS
    tlog = b""

    def send(self, data: bytes) -> bool:
        self.tlog += struct.pack(">Q", (self.now_ns - START_NS) // 1000) + data
        return super().send(data)


class LiveAutopilot:
    """The simulated autopilot as the far end of a run, driving as in the recording that the daemon is given."""

    def __init__(self, cable: RecordingCable, drive: WorldDrive, **options: Any) -> None:
        self._cable = cable
        self._autopilot = SimulatedAutopilot(
            cable,
            lambda now_s: drive.pose(now_s - START_NS / 1e9),
            lambda: cable.now_ns,
            drift_percent=DRIFT_PERCENT,
            **options,
        )

    def step(self, now_ns: int) -> None:
        self._cable.now_ns = now_ns
        self._autopilot.step()


def record_telemetry(folder: Path) -> None:
    """Run the daemon of a case beside the simulated autopilot, and keep what that one sends."""
    query = load_case(folder).query
    with closing(RecordingCable()) as cable, tempfile.TemporaryDirectory() as scratch:
        frames = PlayedFrames(RECORDINGS / query)
        frames.far_end = LiveAutopilot(cable, RECORDED[query].scenario.drive(), **AUTOPILOTS[folder.name])
        run_daemon(folder, Path(scratch), cable, frames, Network.load())
        (folder / TELEMETRY).write_bytes(cable.tlog)


if __name__ == "__main__":
    for each, recorded in RECORDED.items():
        record(each, recorded)
        print(f"{RECORDINGS / each}: {len(list((RECORDINGS / each / 'frames').iterdir()))} frames")
    for folder in cases("run"):
        record_telemetry(folder)
        print(f"{folder / TELEMETRY}: {(folder / TELEMETRY).stat().st_size} bytes")
