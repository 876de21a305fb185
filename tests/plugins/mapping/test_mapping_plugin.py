"""A drive out and home with the real daemon: the map that it makes on the way out brings it home, minutes later."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from edge.camera import CameraHealth, Frame
from edge.config import CameraConfig, Config, DescriptorConfig, MapConfig, SamplingConfig, TelemetryConfig
from edge.daemon import Daemon
from edge.descriptor.network import Network
from edge.journal.records import FrameUsed
from edge.opened_parts import OpenedParts
from edge_plugins.mapping import MappingConfig
from edge_plugins.mapping.place_log import logs_in
from edge_plugins.mapping.plugin import Mapping
from edge_plugins.mapping.status import MappingChanged
from edge_plugins.page import PageConfig
from edge_plugins.recording import RecordingConfig
from sim import Pose
from sim.journal import records_of
from sim.vehicle.autopilot import SimulatedAutopilot
from sim.vehicle.pty_link import open_pty
from tests.camera.test_picture_age import ahead
from tests.common import picture_of
from tests.udp_port import free_port

ROAD_M, SPEED_MPS, SPACING_M = 300.0, 10.0, 2.0
STEP_NS = 100_000_000
PLACES = int(ROAD_M / SPACING_M) + 10


class ToldNetwork(Network):
    """Has described what the camera sees that delivered last."""

    current: NDArray[np.float32]

    def describe(self, images: NDArray[np.uint8]) -> NDArray[np.float32]:
        return self.current


class Trip:
    """A road, driven out and home; what looks along it in one direction sees one thing, in the other another."""

    def __init__(
        self, network: ToldNetwork, *, home: bool = True, stands_s: float = 3.0, ends_m: float = ROAD_M
    ) -> None:
        """ends_m: where a drive that does not lead home is over."""
        self.now_ns, self._ends_m = 10**12, 2 * ROAD_M if home else ends_m
        self._stands_s = stands_s
        self.network = network
        rng = np.random.default_rng(7)
        noise = rng.normal(size=(2, PLACES + 2, 2, 4096)).astype(np.float32)
        self._views = np.maximum(noise[:, :-2] + noise[:, 1:-1] + noise[:, 2:], 0)  # east, then west
        self._rng = rng

    def clock_ns(self) -> int:
        return self.now_ns

    @property
    def driven_m(self) -> float:
        return max(0.0, SPEED_MPS * ((self.now_ns - 10**12) / 1e9 - self._stands_s))

    @property
    def is_over(self) -> bool:
        return self.driven_m > self._ends_m

    @property
    def is_home(self) -> bool:
        return self.driven_m >= ROAD_M

    @property
    def along_m(self) -> float:
        return ROAD_M - abs(ROAD_M - self.driven_m)

    def pose(self, time_s: float) -> Pose:
        moves = SPEED_MPS if self.driven_m else 0.0
        return Pose(self.along_m, 0.0, 270.0 if self.is_home else 90.0, moves, self.driven_m)

    def seen(self, *, ahead: bool) -> NDArray[np.float32]:
        """By a camera that looks ahead, or back."""
        raw = self._views[int(ahead == self.is_home), round(self.along_m / SPACING_M)]
        return np.asarray(np.maximum(raw + self._rng.normal(0, 0.3, raw.shape), 0), np.float32)


class Laps(Trip):
    """The road as a loop, driven twice."""

    @property
    def is_home(self) -> bool:
        return False

    @property
    def along_m(self) -> float:
        return self.driven_m % ROAD_M

    def pose(self, time_s: float) -> Pose:
        angle_rad, radius_m = 2 * math.pi * self.driven_m / ROAD_M, ROAD_M / 2 / math.pi
        moves = SPEED_MPS if self.driven_m else 0.0
        east_m, north_m = radius_m * math.sin(angle_rad), radius_m * (1 - math.cos(angle_rad))
        return Pose(east_m, north_m, (90 - math.degrees(angle_rad)) % 360, moves, self.driven_m)


class Camera:
    """One of the vehicle's cameras."""

    def __init__(self, world: Trip, *, ahead: bool) -> None:
        self._world, self._ahead = world, ahead
        self.health = CameraHealth("running", "", 0)
        self._index = 0
        self._taken_ns = 0

    @property
    def ended(self) -> bool:
        return self._world.is_over

    def take(self, timeout_s: float) -> Frame | None:
        if self._taken_ns == self._world.now_ns:
            return None
        self._taken_ns, self._index = self._world.now_ns, self._index + 1
        self._world.network.current = self._world.seen(ahead=self._ahead)
        return Frame(self.picture(self._index), self._world.now_ns, self._index)

    def picture(self, seed: int) -> NDArray[np.uint8]:
        return picture_of(seed)

    def close(self) -> None:
        pass


class Bends(Trip):
    """The road in bends."""

    def pose(self, time_s: float) -> Pose:
        moves = SPEED_MPS if self.driven_m else 0.0
        headings = np.radians([bend_deg(float(at_m)) for at_m in np.arange(0.5, max(1.0, self.driven_m), 1.0)])
        over_m = self.driven_m - len(headings) + 1  # the last one
        steps = np.append(np.ones(len(headings) - 1), over_m)
        at_m = float(steps @ np.sin(headings)), float(steps @ np.cos(headings))
        return Pose(*at_m, bend_deg(self.driven_m) % 360, moves, self.driven_m)


def bend_deg(driven_m: float) -> float:
    return 90 + 40 * math.sin(driven_m / 40) + 15 * math.sin(driven_m / 15 + 1)


class Turning(Camera):
    """Its pictures turn with the vehicle."""

    def picture(self, seed: int) -> NDArray[np.uint8]:
        return ahead(0.0, seed, faces_deg=bend_deg(self._world.driven_m))


@pytest.fixture(scope="module")
def placed_network() -> ToldNetwork:
    network = ToldNetwork.load()
    assert isinstance(network, ToldNetwork)
    return network


@pytest.fixture
def parts() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


def opened(config: Config, parts: ExitStack, world: Trip, front: Camera, rear: Camera | None) -> Daemon:
    network = world.network
    return Daemon(OpenedParts(config, parts, world.clock_ns, frames=front, mapping_frames=rear, network=network))


def waiting(mapping: Mapping) -> int:
    return mapping.live.store.waiting


def drive(
    world: Trip,
    folder: Path,
    parts: ExitStack,
    mapping: MappingConfig,
    *,
    camera: type[Camera] | None = None,
    kind: Literal["sim", "stream"] = "sim",
    gps_out_only: bool = True,
    killed_at_m: float = math.inf,
    recording: RecordingConfig = RecordingConfig(),  # noqa: B008  # frozen
    keep_pictures: bool = True,
    each_turn: Callable[[float], object] = lambda driven_m: None,
) -> None:
    """The daemon over a whole drive; GPS fails where the vehicle turns round.

    killed_at_m: where the daemon is killed, and started again.
    """
    link = parts.enter_context(closing(open_pty()))
    config = Config(
        camera=CameraConfig(kind=kind, view="front", keep_pictures=keep_pictures),
        descriptor=DescriptorConfig(keep_statistics_min=0.0),
        sampling=SamplingConfig(spacing_m=SPACING_M),
        map=MapConfig(path=mapping.folder),
        plugins={"mapping": mapping, "page": PageConfig(port=0), "recording": recording},
        telemetry=TelemetryConfig(
            connection=f"serial:{link.device}:921600", journal=str(folder / "events.jsonl"), journal_frames=True
        ),
    )
    fails_s = world.now_ns / 1e9 + 3 + ROAD_M / SPEED_MPS if gps_out_only else float("inf")
    autopilot = SimulatedAutopilot(link, world.pose, world.clock_ns, gps_fails_s=fails_s)
    camera = camera or Camera
    rear = None if mapping.camera is msgspec.UNSET else camera(world, ahead=False)
    front = camera(world, ahead=True)
    for until_m in sorted({killed_at_m, math.inf}):
        with ExitStack() as open_parts:
            daemon = opened(config, open_parts, world, front, rear)
            while not world.is_over and world.driven_m < until_m:
                world.now_ns += STEP_NS
                each_turn(world.driven_m)
                for _ in range(2):
                    autopilot.step()
                    daemon.turn()
                while (daemon.parts.plugins.ask("mapping", waiting) or 0) > 8:
                    os.sched_yield()  # a vehicle is slower than any disk
            if world.is_over:
                daemon.last_words()


def believed_on_the_way_home(folder: Path) -> list[FrameUsed]:
    used = list(records_of(folder / "events.jsonl", FrameUsed))
    return [frame for frame in used if frame.accepted and frame.stamp_ns > 10**12 + (3 + ROAD_M / SPEED_MPS) * 1e9]


def mapping_to(folder: Path, *, second_camera: bool, keypoints: bool = False) -> MappingConfig:
    camera = CameraConfig(kind="sim", view="rear") if second_camera else msgspec.UNSET
    return MappingConfig(folder=str(folder), min_free_mb=0.0, behind_m=60.0, camera=camera, keypoints=keypoints)


def test_home_on_the_map_of_the_way_out(placed_network: ToldNetwork, tmp_path: Path, parts: ExitStack) -> None:
    world = Trip(placed_network)
    drive(world, tmp_path, parts, mapping_to(tmp_path / "maps", second_camera=True))
    changes = list(records_of(tmp_path / "events.jsonl", MappingChanged))
    assert [change.state for change in changes][-2:] == ["mapping", "waiting"]
    assert changes[-1].why in ("no GPS", "position not known to 5 m")
    assert changes[-1].places == pytest.approx(ROAD_M / SPACING_M, abs=5)
    found = believed_on_the_way_home(tmp_path)
    assert len(found) > 0.5 * ROAD_M / SPACING_M
    assert {frame.direction for frame in found} == {"reverse"}
    assert {frame.map for frame in found} == {changes[-1].map}
    for frame in found:
        driven_m = SPEED_MPS * (frame.stamp_ns - 10**12 - 3e9) / 1e9
        assert frame.place is not None
        assert frame.place * SPACING_M == pytest.approx(2 * ROAD_M - driven_m, abs=4 * SPACING_M)
    assert len(logs_in(tmp_path / "maps")) == 1, "the next start makes a map of it"


@pytest.mark.parametrize(("keep_pictures", "second_camera"), [(True, True), (False, True), (False, False)])
def test_one_key_says_whether_anything_of_a_drive_keeps_a_picture(
    placed_network: ToldNetwork, tmp_path: Path, parts: ExitStack, keep_pictures: bool, second_camera: bool
) -> None:
    world = Trip(placed_network, home=False, ends_m=140.0)
    mapping = mapping_to(tmp_path / "maps", second_camera=second_camera, keypoints=True)
    recording = RecordingConfig(folder=str(tmp_path / "recordings"), min_free_mb=0.0)
    drive(world, tmp_path, parts, mapping, recording=recording, keep_pictures=keep_pictures)
    (made,) = logs_in(tmp_path / "maps")
    assert made.stat().st_size > 50 * 8192 * 2, "it was mapped"
    with_pictures = {
        file.name
        for file in tmp_path.rglob("*")
        if file.is_file() and b"\xff\xd8\xff\xe0\x00\x10JFIF" in file.read_bytes()
    }
    assert (made.name in with_pictures) == keep_pictures
    assert bool(with_pictures) == keep_pictures
    assert (tmp_path / "recordings").exists() == keep_pictures


@pytest.mark.parametrize(
    ("camera", "keypoints", "said"),
    [
        (CameraConfig(kind="sim", view="rear"), True, ["[mapping.camera] fov_deg"]),
        (CameraConfig(kind="sim", view="rear"), False, []),
        (CameraConfig(kind="sim", view="rear", fov_deg=80.0), True, []),
        (msgspec.UNSET, True, ["[camera] fov_deg"]),
    ],
)
def test_a_field_of_view_that_is_not_set_is_assumed_and_that_is_said_once(
    placed_network: ToldNetwork,
    tmp_path: Path,
    parts: ExitStack,
    caplog: pytest.LogCaptureFixture,
    camera: CameraConfig | msgspec.UnsetType,
    keypoints: bool,
    said: list[str],
) -> None:
    world, mapping = Trip(placed_network, home=False), MappingConfig(str(tmp_path), camera=camera, keypoints=keypoints)
    config = Config(
        camera=CameraConfig(kind="sim"),
        map=MapConfig(path=str(tmp_path)),
        plugins={"mapping": mapping},
        telemetry=TelemetryConfig(connection=f"udpin:127.0.0.1:{free_port()}", journal=""),
    )
    rear = None if camera is msgspec.UNSET else Camera(world, ahead=False)
    opened(config, parts, world, Camera(world, ahead=True), rear)
    found = [one.message for one in caplog.records if "fov_deg" in one.message]
    assert found == [f"{where}: not known, and taken as 75 ± 10 degrees" for where in said]


@pytest.mark.parametrize("second_camera", [True, False])
@pytest.mark.parametrize(("camera", "from_m"), [(Turning, 220.0), (Camera, math.inf)])
def test_the_pictures_of_a_stream_are_mapped_once_their_age_is_known(
    placed_network: ToldNetwork,
    tmp_path: Path,
    parts: ExitStack,
    camera: type[Camera],
    from_m: float,
    second_camera: bool,
) -> None:
    """Half a minute with bends shows it; those of a camera that never shows one may be of another place."""
    world, maps = Bends(placed_network, home=False, stands_s=8.0), tmp_path / "maps"
    mapping = mapping_to(maps, second_camera=second_camera)
    if second_camera:
        mapping = msgspec.structs.replace(mapping, camera=CameraConfig(kind="stream", view="rear"))
    mapped_m: list[float] = []

    def watch(driven_m: float) -> None:
        if logs_in(maps):
            mapped_m.append(driven_m)

    kind: Literal["sim", "stream"] = "sim" if second_camera else "stream"
    drive(world, tmp_path, parts, mapping, camera=camera, kind=kind, gps_out_only=False, each_turn=watch)
    assert min(mapped_m, default=math.inf) == pytest.approx(from_m, abs=10)


def test_a_daemon_that_was_killed_on_the_way_out_comes_home_on_one_map(
    placed_network: ToldNetwork, tmp_path: Path, parts: ExitStack
) -> None:
    folder = tmp_path / "maps"
    drive(Trip(placed_network), tmp_path, parts, mapping_to(folder, second_camera=True), killed_at_m=0.6 * ROAD_M)
    assert len(logs_in(folder)) == 1
    found = believed_on_the_way_home(tmp_path)
    places = [frame.place for frame in found if frame.place is not None]
    assert len(places) > 0.5 * ROAD_M / SPACING_M
    assert min(places) * SPACING_M < 0.4 * ROAD_M, "of before the restart"
    assert max(places) * SPACING_M > 0.65 * ROAD_M, "of after it"


def test_the_second_lap_is_recognized_on_the_first(
    placed_network: ToldNetwork, tmp_path: Path, parts: ExitStack
) -> None:
    """With one camera, which maps and recognizes."""
    drive(Laps(placed_network), tmp_path, parts, mapping_to(tmp_path, second_camera=False), gps_out_only=False)
    used = list(records_of(tmp_path / "events.jsonl", FrameUsed))
    driven_m = np.array([SPEED_MPS * (frame.stamp_ns - 10**12 - 3e9) / 1e9 for frame in used])
    accepted = np.array([frame.accepted for frame in used])
    assert not accepted[driven_m < ROAD_M].any()
    second = driven_m > ROAD_M + 2 * 40 * SPACING_M
    assert accepted[second].mean() > 0.8
    for at_m, frame in zip(driven_m, used, strict=True):
        if frame.accepted and frame.place is not None:
            assert (frame.direction, frame.order) == ("forward", "same")
            assert frame.place * SPACING_M == pytest.approx(at_m - ROAD_M, abs=4 * SPACING_M)


def test_the_way_out_alone_recognizes_nothing(placed_network: ToldNetwork, tmp_path: Path, parts: ExitStack) -> None:
    """Neither what the rear camera has just passed, nor, with one camera, what it saw itself."""
    for second_camera in (True, False):
        folder = tmp_path / str(second_camera)
        folder.mkdir()
        drive(Trip(placed_network, home=False), folder, parts, mapping_to(folder, second_camera=second_camera))
        used = list(records_of(folder / "events.jsonl", FrameUsed))
        assert len(used) > 100
        assert sum(frame.accepted for frame in used) == 0
        assert logs_in(folder)


class SlowNetwork(ToldNetwork):
    """Takes its time, like a small computer's."""

    world: SlowWorld
    takes_ns = described = 0

    def describe(self, images: NDArray[np.uint8]) -> NDArray[np.float32]:
        self.world.now_ns += self.takes_ns
        self.described += 1
        return self.current


class SlowWorld(Trip):
    """In which time passes only where somebody works or waits."""

    network: SlowNetwork


class WaitingCamera(Camera):
    """Delivers 20 frames a second; the newest one, if somebody was slow."""

    PERIOD_NS = 50_000_000

    def take(self, timeout_s: float) -> Frame | None:
        world = self._world
        index = world.now_ns // self.PERIOD_NS
        if index == self._index and timeout_s:
            world.now_ns = min((index + 1) * self.PERIOD_NS, world.now_ns + round(timeout_s * 1e9))
            index = world.now_ns // self.PERIOD_NS
        if index == self._index:
            return None
        self._index = index
        world.network.current = world.seen(ahead=self._ahead)
        return Frame(picture_of(index), index * self.PERIOD_NS, index)


@pytest.mark.parametrize(
    ("takes_s", "least_first", "least_second", "most_second"),
    [(0.02, 0.97, 0.97, 1.0), (0.12, 0.97, 0.2, 0.6), (0.18, 0.97, 0.1, 0.35)],
)
def test_a_slow_computer_thins_the_second_camera_first(
    tmp_path: Path, parts: ExitStack, takes_s: float, least_first: float, least_second: float, most_second: float
) -> None:
    """At a place each 0.2 s. Shares of the places that are described of each camera."""
    network = SlowNetwork.load()
    assert isinstance(network, SlowNetwork)
    world = network.world = SlowWorld(network, home=False)
    network.takes_ns = round(takes_s * 1e9)
    link = parts.enter_context(closing(open_pty()))
    folder = tmp_path / "maps"
    config = Config(
        camera=CameraConfig(kind="sim", view="front"),
        descriptor=DescriptorConfig(keep_statistics_min=0.0),
        map=MapConfig(path=str(folder)),
        plugins={"mapping": mapping_to(folder, second_camera=True), "page": PageConfig(port=0)},
        telemetry=TelemetryConfig(connection=f"serial:{link.device}:921600", journal=str(tmp_path / "events.jsonl")),
    )
    autopilot = SimulatedAutopilot(link, world.pose, world.clock_ns)
    front, rear = WaitingCamera(world, ahead=True), WaitingCamera(world, ahead=False)
    daemon = opened(config, parts, world, front, rear)
    while not world.is_over:
        autopilot.step()
        daemon.turn()
    first = daemon.last_words().frames_used
    places = ROAD_M / SPACING_M
    assert first / places >= least_first
    assert least_second <= (network.described - first) / places <= most_second
