"""What is the same on every processor, here and on emulated ones: fc6 to the byte, the grid to a stated tolerance.

Emulation needs qemu-user (Debian: apt-get install qemu-user). For aarch64 it also needs a folder with Python and our
packages for it, which make_aarch64_root.sh beside this file makes, named by LOOKBACK_AARCH64_ROOT.
"""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from numpy.typing import NDArray

from edge.config import DescriptorConfig, SamplingConfig
from edge.descriptor.network import Network
from edge.descriptor.normalize import normalize
from edge.descriptor.open_network import cosines
from edge.feed import read_feed
from edge.journal.records import FrameUsed
from edge.reference_map.store import open_map
from edge_plugins.mapping.earlier_drives import FEWEST_PLACES
from sim.journal import records_of
from sim.maps.command import build_map
from sim.world.camera import open_renderer
from sim.world.recording import times_by_distance
from sim.world.scenario import Scenario
from tests.common import ROOT
from tests.descriptor.processor_answers import SPACING_M, by_grid, matched
from tests.udp_port import free_port

PROGRAM = Path(__file__).with_name("processor_answers.py")
TOLERANCE = 1e-5
"""Of the grid's values between processors, as a share of the largest: ten times what a Cortex-A76 differed by (9.6e-7,
emulated; a Haswell by nothing)."""
SLOW_NS = 4_000_000_000
"""Between two pictures of a drive that an emulated processor keeps up with."""
KEYPOINTS = ("xy", "scores", "descriptors")
XY_TOLERANCE, SCORE_TOLERANCE = 1e-2, 1e-4
"""Of keypoints, in pixels and of scores up to 1."""
BEST, PLACE, IS_BELIEVED, CONFIDENCE = range(4)


def rendered(scenario: Scenario, frames: int) -> NDArray[np.uint8]:
    """The first pictures (frames, H, W, 3) of a drive."""
    drive = scenario.drive()
    renderer = open_renderer(scenario, drive)
    times_s = times_by_distance(drive, SPACING_M)[:frames]
    images = np.stack([renderer.render(drive.pose(time_s, 0.0), time_s) for time_s in times_s])
    renderer.close()
    return images


def write_drives(folder: Path) -> None:
    scene = partial(Scenario, seed=7, length_m=240.0)
    road = rendered(scene(view="rear"), 60)
    home = rendered(scene(direction="reverse", light="night", drive_seed=2), 40)
    np.savez(folder / "drives.npz", pictures=road[:1], road=by_grid(road), home=by_grid(home))


@pytest.fixture(scope="module")
def drives(make_once: Callable[[str, Callable[[Path], object]], Path]) -> Path:
    """What processor_answers.py is given: a road of 60 places by day, and 40 frames of the way home by night."""
    return make_once("processors", write_drives) / "drives.npz"


def answers(drives: Path, made: Path, *command: str, **environment: str) -> tuple[str, dict[str, NDArray[np.float64]]]:
    """What PROGRAM prints, and what it writes to `made`."""
    done = subprocess.run(
        [*command, str(PROGRAM), str(drives), str(made)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, **environment},
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout, dict(np.load(made))


def emulator(architecture: str) -> str:
    found = shutil.which(f"qemu-{architecture}") or shutil.which(f"qemu-{architecture}-static")
    if found is None:
        pytest.skip(f"needs qemu-{architecture}: apt-get install qemu-user")
    return found


def check_as_here(drives: Path, tmp_path: Path, *command: str, **environment: str) -> None:
    """Another processor's answers are those of this one, as far as they are held."""
    exact, here = answers(drives, tmp_path / "here.npz", sys.executable, PYTHONPATH=str(ROOT))
    other_exact, there = answers(drives, tmp_path / "there.npz", *command, **environment)
    assert other_exact == exact
    difference = np.abs(there["raw"] - here["raw"]).max() / np.abs(here["raw"]).max()
    road = np.load(drives)["road"].astype(np.float64)
    mean, deviation = road.mean(axis=0), road.std(axis=0)
    after_nsd = (normalize(one["raw"].astype(np.float32), mean, deviation) for one in (here, there))
    cosine = cosines(*after_nsd).min()
    costs = np.abs(there["costs"] - here["costs"]).max()
    print(f"largest difference {difference:.2g} of the largest value; 1 - cosine {1 - cosine:.2g}; costs by {costs}")
    assert difference <= TOLERANCE
    assert cosine >= 0.999999
    assert costs <= 1  # of 16384, what a cosine distance of 1 costs
    np.testing.assert_array_equal(there["matched"][:, :CONFIDENCE], here["matched"][:, :CONFIDENCE])
    np.testing.assert_allclose(there["matched"][:, CONFIDENCE], here["matched"][:, CONFIDENCE], atol=1e-3)
    check_keypoints(here, there)


def check_keypoints(here: dict[str, NDArray[np.float64]], there: dict[str, NDArray[np.float64]]) -> None:
    """The same points, but for some of those whose score is that of the last one kept."""
    pixels = [{tuple(pixel): row for row, pixel in enumerate(np.rint(one["xy"] * 8).tolist())} for one in (here, there)]
    rows = np.array([(row, pixels[1][pixel]) for pixel, row in pixels[0].items() if pixel in pixels[1]])
    one, other = ({key: each[key][rows[:, side]] for key in KEYPOINTS} for side, each in enumerate((here, there)))
    off = {key: float(np.abs(one[key].astype(float) - other[key]).max()) for key in KEYPOINTS}
    print(f"{len(rows)} of {len(here['xy'])} keypoints are the same; they differ by {off}")
    assert len(rows) >= 0.99 * len(here["xy"])
    assert off["xy"] <= XY_TOLERANCE
    assert off["scores"] <= SCORE_TOLERANCE
    assert off["descriptors"] <= 1  # of 127


@pytest.mark.skipif(os.uname().machine != "x86_64", reason="runs this Python on an older processor of the same kind")
@pytest.mark.long
def test_x86_without_vnni(drives: Path, tmp_path: Path) -> None:
    """Haswell has AVX2, whose int8 products saturate at 16 bits."""
    python = str(Path(sys.executable).resolve())
    path = os.pathsep.join([str(ROOT), *filter(None, sys.path)])
    check_as_here(drives, tmp_path, emulator("x86_64"), "-cpu", "Haswell", python, PYTHONPATH=path)


@pytest.fixture
def aarch64() -> tuple[list[str], dict[str, str]]:
    """The command of an emulated Python, and its environment."""
    root = os.environ.get("LOOKBACK_AARCH64_ROOT")
    if not root:
        pytest.skip("needs LOOKBACK_AARCH64_ROOT: see make_aarch64_root.sh")
    command = [emulator("aarch64"), "-L", root, "-cpu", "cortex-a76", f"{root}/usr/bin/python3"]
    return command, {"PYTHONPATH": f"{ROOT}:{root}/packages", "PYTHONHOME": f"{root}/usr"}


@pytest.mark.long
def test_aarch64(drives: Path, tmp_path: Path, aarch64: tuple[list[str], dict[str, str]]) -> None:
    command, environment = aarch64
    check_as_here(drives, tmp_path, *command, **environment)


@pytest.mark.long
def test_the_daemon_on_aarch64(
    tmp_path: Path, aarch64: tuple[list[str], dict[str, str]], write_traverse: Callable[..., Path], grid: Network
) -> None:
    """It recognizes places on a map that was made here, serves the page, and the map that it makes is read here."""
    command, environment = aarch64
    feed = read_feed(write_traverse(tmp_path / "feed"))
    build_map([feed], tmp_path / "map", DescriptorConfig(model="grid"), SamplingConfig(), network=grid)
    link, port = free_port(), free_port(socket.SOCK_STREAM)
    rows = [f"{row.file},{number * SLOW_NS}" for number, row in enumerate(feed.rows)]
    (feed.path / "frames.csv").write_text("\n".join(["file,stamp_ns", *rows, ""]))
    settings: dict[str, dict[str, Any]] = {
        "camera": {"kind": "feed", "device": str(feed.path)},
        "map": {"path": str(tmp_path / "map")},
        "sequence": {"length": 10},
        "acceptance": {"uniqueness_min": 1.02, "window_m": 10.0},
        "mapping": {"folder": str(tmp_path / "maps"), "resume_min": 0},
        "telemetry": {"connection": f"udpin:127.0.0.1:{link}", "journal": "events.jsonl", "journal_frames": True},
        "page": {"port": port},
    }
    config, journal = tmp_path / "lookback.toml", tmp_path / "events.jsonl"
    config.write_text(tomli_w.dumps(settings))
    speed = str(2e9 / SLOW_NS)  # the map has a place every 2 m
    stand_in = [sys.executable, "-m", "edge", "dev", "sim", "autopilot", "--udp", f"127.0.0.1:{link}", "--speed", speed]
    run = [*command, "-m", "edge", "run", str(config)]
    with (
        subprocess.Popen(stand_in, stdout=subprocess.DEVNULL) as autopilot,
        subprocess.Popen(run, env={**os.environ, **environment}) as daemon,
    ):
        try:
            deadline_s, believed, mapped = time.monotonic() + 900.0, [False], 0
            while sum(believed) < 5 or mapped < FEWEST_PLACES:
                assert daemon.poll() is None and time.monotonic() < deadline_s
                time.sleep(2.0)
                if journal.exists() and any(records_of(journal, FrameUsed)):
                    believed = [frame.accepted for frame in records_of(journal, FrameUsed)]
                    try:
                        with urllib.request.urlopen(f"http://127.0.0.1:{port}/status.json", timeout=120) as answer:
                            status = json.load(answer)
                    except urllib.error.HTTPError as error:
                        assert error.code == 503, error  # no turn of the daemon ended in time
                    else:
                        mapped = status["mapping"]["status"]["places"]
        finally:
            daemon.terminate()
            autopilot.terminate()
            assert daemon.wait(60) == 0
    assert status["frames_used"] >= FEWEST_PLACES
    with subprocess.Popen(run, env={**os.environ, **environment}) as daemon:  # the next start makes the map
        try:
            while not (made := [path for path in (tmp_path / "maps").iterdir() if (path / "map.json").exists()]):
                assert daemon.poll() is None and time.monotonic() < deadline_s
                time.sleep(1.0)
        finally:
            daemon.terminate()
            assert daemon.wait(60) == 0
    places = sum(len(open_map(path).places) for path in made)
    print(f"{len(believed)} frames, {sum(believed)} believed; {places} places mapped; the page: {status['state']}")
    assert places >= FEWEST_PLACES


@pytest.mark.parametrize("seed", range(3))
def test_ten_times_the_tolerance_changes_no_place_and_no_decision(drives: Path, seed: int) -> None:
    given, rng = np.load(drives), np.random.default_rng(seed)
    exact = [given["road"], given["home"]]
    off = [one + 10 * TOLERANCE * one.max() * rng.uniform(-1, 1, one.shape).astype(np.float32) for one in exact]
    wanted, found = matched(*exact), matched(*off)
    assert 10 <= wanted[:, IS_BELIEVED].sum() < len(wanted)
    np.testing.assert_array_equal(found[:, :CONFIDENCE], wanted[:, :CONFIDENCE])
    np.testing.assert_allclose(found[:, CONFIDENCE], wanted[:, CONFIDENCE], atol=1e-3)  # they changed by 1e-4
