"""What is the same on every processor, here and on emulated ones: fc6 to the byte, the grid to a stated tolerance.

Emulation needs qemu-user (Debian: apt-get install qemu-user). For aarch64 it also needs a folder with Python and our
packages for it, which make_aarch64_root.sh beside this file makes, named by LOOKBACK_AARCH64_ROOT.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.descriptor.normalize import normalize
from edge.descriptor.open_network import cosines
from sim.world.camera import open_renderer
from sim.world.recording import times_by_distance
from sim.world.scenario import Scenario
from tests.descriptor.processor_answers import SPACING_M, by_grid, matched

ROOT = Path(__file__).parents[2]
PROGRAM = Path(__file__).with_name("processor_answers.py")
TOLERANCE = 1e-5
"""Of the grid's values between processors, as a share of the largest: ten times what a Cortex-A76 differed by (9.6e-7,
emulated; a Haswell by nothing)."""
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


@pytest.mark.long
def test_aarch64(drives: Path, tmp_path: Path) -> None:
    root = os.environ.get("LOOKBACK_AARCH64_ROOT")
    if not root:
        pytest.skip("needs LOOKBACK_AARCH64_ROOT: see make_aarch64_root.sh")
    command = (emulator("aarch64"), "-L", root, "-cpu", "cortex-a76", f"{root}/usr/bin/python3")
    path = f"{ROOT}:{root}/packages"
    check_as_here(drives, tmp_path, *command, PYTHONPATH=path, PYTHONHOME=f"{root}/usr")


@pytest.mark.parametrize("seed", range(3))
def test_ten_times_the_tolerance_changes_no_place_and_no_decision(drives: Path, seed: int) -> None:
    given, rng = np.load(drives), np.random.default_rng(seed)
    exact = [given["road"], given["home"]]
    off = [one + 10 * TOLERANCE * one.max() * rng.uniform(-1, 1, one.shape).astype(np.float32) for one in exact]
    wanted, found = matched(*exact), matched(*off)
    assert 10 <= wanted[:, IS_BELIEVED].sum() < len(wanted)
    np.testing.assert_array_equal(found[:, :CONFIDENCE], wanted[:, :CONFIDENCE])
    np.testing.assert_allclose(found[:, CONFIDENCE], wanted[:, CONFIDENCE], atol=1e-3)  # they changed by 1e-4
