"""Fixtures that several folders of tests need."""

from __future__ import annotations

import contextlib
import fcntl
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from functools import partial
from hashlib import blake2b
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import settings
from numpy.typing import NDArray

from edge.config import FIRST_NETWORK, DescriptorConfig, SamplingConfig
from edge.descriptor.model_file import ModelInfo
from edge.feed import FeedHeader, FeedRow, read_feed
from edge.feed.writer import FeedWriter
from edge.reference_map.store import ModelKey, RegionsKey
from edge_plugins.mapping.builder import MapBuilder, Place
from sim import geodetic
from sim.evaluation.memoizing_network import MemoizingNetwork
from sim.maps.command import build_map
from sim.model_tools.onnx_graph import MEAN_RGB, STD_RGB
from sim.vehicle.pty_link import PtyLink, open_pty
from tests.guard import sitecustomize
from tests.tlog import frames_of

os.environ["PYTHONPATH"] = os.pathsep.join(
    filter(None, (str(Path(sitecustomize.__file__).parent), os.environ.get("PYTHONPATH")))
)

settings.register_profile("repeatable", derandomize=True, database=None, deadline=None)
settings.load_profile("repeatable")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """Workers of `-n auto`: tests wait for processes and clocks more than they compute."""
    return max(4, 2 * (os.cpu_count() or 1))


MakeOnce = Callable[[str, Callable[[Path], object]], Path]
SHARED = Path(__file__).parents[2] / "shared"


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of real recordings and float weights beside the checkout; what needs it is skipped without it."""
    if not SHARED.is_dir():
        pytest.skip(f"needs the real recordings in {SHARED.name}/ beside the checkout, which is not there")
    return SHARED


@pytest.fixture(scope="session")
def read_tlog(shared: Path) -> Callable[[str], Iterator[tuple[int, bytes]]]:
    """Yields (arrival in ns, one MAVLink 2 frame) of a real autopilot's recording, named without its suffix."""
    return lambda name: frames_of(shared / "autopilot" / f"{name}.tlog")


SMALL_COUNT = 12
SMALL_WIDTH, SMALL_HEIGHT = 64, 48
SMALL_PERIOD_NS = 50_000_000


def _picture(index: int) -> NDArray[np.uint8]:
    """A picture whose mean level tells its index, whatever a lossy codec makes of it."""
    return np.full((SMALL_HEIGHT, SMALL_WIDTH, 3), 20 + 16 * index, np.uint8)


@pytest.fixture
def feed_path(tmp_path: Path) -> Path:
    path = tmp_path / "feed"
    with FeedWriter(path, FeedHeader("test", "front", SMALL_WIDTH, SMALL_HEIGHT)) as writer:
        for index in range(SMALL_COUNT):
            writer.write(_picture(index), FeedRow("", 1_000_000_000 + index * SMALL_PERIOD_NS, distance_m=float(index)))
    return path


@pytest.fixture
def video_path(tmp_path: Path) -> Path:
    """MJPG in AVI at 20 frames a second: what every OpenCV build writes."""
    path = tmp_path / "drive.avi"
    video = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 20.0, (SMALL_WIDTH, SMALL_HEIGHT))
    for index in range(SMALL_COUNT):
        video.write(_picture(index))
    video.release()
    return path


def _street(length_px: int) -> np.ndarray:
    """A long strip of colored fronts with windows: every stretch of it looks like no other."""
    rng = np.random.default_rng(7)
    strip = np.full((120, length_px, 3), 200, dtype=np.uint8)
    at = 0
    while at < length_px:
        width, top = int(rng.integers(40, 110)), int(rng.integers(10, 70))
        cv2.rectangle(strip, (at, top), (at + width, 119), rng.integers(20, 235, 3).tolist(), -1)
        for _ in range(int(rng.integers(1, 7))):
            x, y = at + int(rng.integers(0, width)), int(rng.integers(top, 110))
            cv2.rectangle(strip, (x, y), (x + int(rng.integers(5, 25)), y + 12), rng.integers(0, 255, 3).tolist(), -1)
        at += width
    return strip


@pytest.fixture(scope="session")
def write_traverse() -> Callable[..., Path]:
    """Writes a feed that passes the fronts of one and the same street, 2 m and `period_ms` a frame."""
    strip = _street(160 + 12 * 80)

    def write(
        path: Path, frames: range = range(80), *, noise: float = 0.0, period_ms: int = 50, is_located: bool = True
    ) -> Path:
        rng = np.random.default_rng(1)
        with FeedWriter(path, FeedHeader(path.name, "front", 160, 120, time_sigma_s=0.0)) as writer:
            for row, frame in enumerate(frames):
                image = strip[:, 12 * frame : 12 * frame + 160] + rng.normal(0, noise, (120, 160, 3))
                writer.write(
                    image.clip(0, 255).astype(np.uint8),
                    FeedRow(
                        "",
                        row * period_ms * 1_000_000,
                        lat_deg=-27.0 + frame * 2 / 110_800 if is_located else None,
                        lon_deg=153.0 if is_located else None,
                        heading_deg=0.0,
                        distance_m=row * 2.0 if is_located else None,
                    ),
                )
        return path

    return write


@pytest.fixture(scope="session")
def make_once(tmp_path_factory: pytest.TempPathFactory) -> MakeOnce:
    """Gives a folder that is filled by the worker that first asks for its name; the others wait, and share it."""
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent

    def make(name: str, fill: Callable[[Path], object]) -> Path:
        with (folder / f"{name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not (folder / name).exists():
                half_done = Path(tempfile.mkdtemp(dir=folder))
                fill(half_done)
                half_done.rename(folder / name)
        return folder / name

    return make


class SharedNetwork(MemoizingNetwork):
    """Describes each picture once for all workers, which find it in a folder."""

    folder: Path

    def describe(self, images: NDArray[np.uint8]) -> NDArray[np.float32]:
        key = blake2b(images.tobytes(), digest_size=16).digest()
        if key not in self._known:
            file = self.folder / key.hex()
            if file.exists():
                self._known[key] = np.load(file)
                self._known[key].flags.writeable = False
            else:
                described = super().describe(images)
                with contextlib.suppress(OSError), tempfile.NamedTemporaryFile(dir=self.folder) as half_done:
                    np.save(half_done, described)  # fails where a test has filled the disk
                    half_done.flush()
                    file.hardlink_to(half_done.name)
        return self._known[key]


def _shared(make_once: MakeOnce, name: str, path: Path | None) -> MemoizingNetwork:
    network = SharedNetwork.load(path)
    assert isinstance(network, SharedNetwork)
    network.folder = make_once(f"described by {name}", lambda folder: None)
    return network


@pytest.fixture(scope="session")
def network(make_once: MakeOnce) -> MemoizingNetwork:
    """fc6, for tests whose maps or configs name no other network."""
    return _shared(make_once, "fc6", None)


@pytest.fixture(scope="session")
def grid(make_once: MakeOnce) -> MemoizingNetwork:
    """The same with the network of new installations, in a fourth of fc6's time: 9 ms a picture instead of 34."""
    return _shared(make_once, FIRST_NETWORK, Path(FIRST_NETWORK))


@pytest.fixture(scope="session")
def golden_run(make_once: MakeOnce, network: MemoizingNetwork) -> Callable[[Path], Path]:
    """Runs the daemon of a golden once for all workers: a folder of its outputs, and `list.drive`, what it was told."""
    from tests.golden.harness import run_case

    def fill(case: Path, folder: Path) -> None:
        maps, drive = make_once("golden", lambda folder: None), folder / "list.drive"
        for name, text in run_case(case, maps, network, own=folder / "run", drive=drive).items():
            (folder / name).write_text(text, encoding="utf-8")

    return lambda case: make_once(f"golden_{case.name}", partial(fill, case))


@pytest.fixture(scope="session")
def make_street(
    grid: MemoizingNetwork, write_traverse: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory
) -> Callable[..., Path]:
    """Makes a folder with the `feed` of a drive along the street, and the `map` made of it by the network `grid`."""

    def make(frames: range = range(80), *, period_ms: int = 50, sampling: SamplingConfig | None = None) -> Path:
        folder = tmp_path_factory.mktemp("street")
        feed = read_feed(write_traverse(folder / "feed", frames, period_ms=period_ms))
        build_map([feed], folder / "map", DescriptorConfig(FIRST_NETWORK), sampling or SamplingConfig(), network=grid)
        return folder

    return make


@pytest.fixture(scope="session")
def play_on() -> Callable[..., Path]:
    """Copies a feed to one that no test outlasts: an hour of 5 frames a second: a busy machine keeps up."""

    def copy(feed: Path, path: Path, period_ns: int = 200_000_000) -> Path:
        files = [row.file for row in read_feed(feed).rows]
        shutil.copytree(feed, path)
        rows = [f"{files[number % len(files)]},{number * period_ns}" for number in range(18_000)]
        (path / "frames.csv").write_text("\n".join(["file,stamp_ns", *rows]), encoding="utf-8")
        return path

    return copy


@pytest.fixture
def map_along(tmp_path: Path) -> Callable[..., Path]:
    """Makes a map of one or more drives along points, in meters east and north of the simulation's origin."""

    def make(
        *drives: NDArray[np.float64],
        driven_m: Sequence[NDArray[np.float64]] | None = None,
        name: str = "map",
        lon_shift_deg: float = 0.0,
        source: str = "drive_{}",
        sigma_m: Callable[[int], float] = lambda row: 1.5,
        alt_m: Callable[[int], float] = lambda row: np.nan,
        heading_deg: Callable[[int], float] = lambda row: np.nan,
    ) -> Path:
        path, rng = tmp_path / name, np.random.default_rng(1)
        model, regions = ModelKey("test", "0" * 64, "fc6", 4), RegionsKey("whole", 1.0)
        with MapBuilder(path, model, regions, SamplingConfig()) as new:
            for number, points_m in enumerate(drives):
                new.begin_segment(source.format(number), "rear")
                legs_m = np.hypot(*np.diff(points_m, axis=0).T)
                along_m = np.r_[0.0, np.cumsum(legs_m)] if driven_m is None else driven_m[number]
                for row, (point_m, route_m) in enumerate(zip(points_m, along_m, strict=True)):
                    lat_deg, lon_deg = (
                        geodetic(float(point_m[0]), float(point_m[1]), lon_shift_deg)
                        if np.isfinite(point_m).all()
                        else (np.nan, np.nan)
                    )
                    known = lat_deg, lon_deg, alt_m(row), heading_deg(row), float(route_m)
                    place = Place(row, *known, position_sigma_m=sigma_m(row))
                    new.add(rng.random((1, 4), dtype=np.float32), place)
            new.finish()
        return path

    return make


@pytest.fixture
def cable() -> Iterator[PtyLink]:
    """The autopilot's end of a serial cable."""
    with closing(open_pty()) as link:
        yield link


@pytest.fixture
def info() -> ModelInfo:
    """What a float network of random weights says of itself."""
    return ModelInfo(
        name="random",
        tap="fc6",
        dimensions=4096,
        precision="float32",
        input_size=224,
        channel_order="BGR",
        mean_rgb=MEAN_RGB,
        std_rgb=STD_RGB,
        license="not stated",
        source="not stated",
        weights_sha256="",
        calibration="",
    )
