"""The same picture gives the same bytes on every processor: regions and fc6 here, and on emulated processors.

The grid computes in float, whose last bits differ from processor to processor: what is held there is the place that
each picture is matched with, and how far descriptors and costs may lie apart.

Emulation needs qemu-user (Debian: apt-get install qemu-user). For aarch64 it also needs a folder with Python and our
packages for it, which make_aarch64_root.sh beside this file makes, named by LOOKBACK_AARCH64_ROOT.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from edge.reference_map.costs import COST_ONE

ROOT = Path(__file__).parents[2]
PROGRAM = """
import hashlib
import numpy as np
from edge.descriptor.network import Network, lacks_int8_products
from edge.descriptor.network import cut_regions
from edge.reference_map.costs import CostMatcher, encode

rng = np.random.default_rng(3)
soft = np.cumsum(rng.integers(-9, 10, (480, 640, 3)), axis=1) % 256
harsh = rng.integers(0, 2, (1080, 1920, 3)) * 255  # black and white at random: the largest sums
network = Network.load()
raw = []
for image in (soft, harsh):
    regions = cut_regions(image.astype(np.uint8), "left-right", 0.4, (224, 224))
    raw.append(network.describe(regions))
    print("regions", hashlib.sha256(regions.tobytes()).hexdigest())
    print("fc6", hashlib.sha256(raw[-1].tobytes()).hexdigest())
places = encode(np.stack(raw))
costs = CostMatcher.of_encoded(places).costs(np.stack(raw))
print("costs", hashlib.sha256(costs.tobytes()).hexdigest())
"""


GRID = """
import json
from pathlib import Path
import numpy as np
from edge.descriptor.network import Network
from edge.descriptor.open_network import check_pictures, normalized_set
from edge.reference_map.costs import CostMatcher, encode

network = Network.load(Path("grid"))
places = check_pictures(network.size)[:, 0]
darker = (0.5 * places + np.random.default_rng(4).normal(0, 20, places.shape)).clip(0, 255).astype(np.uint8)
mapped, seen = (normalized_set(network.describe(one).reshape(len(one), 2, -1)) for one in (places, darker))
costs = CostMatcher.of_encoded(encode(mapped)).costs(seen)
print(json.dumps({"costs": costs.tolist(), "seen": seen[:, :, ::37].tolist()}))
"""
MOST_APART, MOST_COST_APART = 0.002, 2e-4
"""Of a dimension, in standard deviations; of a cost, where 1 is the cost of descriptors that have nothing in common."""


def assert_the_grid_holds(here: str, there: str) -> None:
    """Both of GRID: the same nearest place and region order for each picture, and numbers about as near."""
    one, other = (json.loads(text) for text in (here, there))
    costs, costs_there = (np.array(each["costs"]) for each in (one, other))
    assert (costs.reshape(len(costs), -1).argmin(axis=1) == costs_there.reshape(len(costs), -1).argmin(axis=1)).all()
    assert np.abs(costs - costs_there).max() <= MOST_COST_APART * COST_ONE
    assert np.abs(np.array(one["seen"]) - np.array(other["seen"])).max() <= MOST_APART


def answers(*command: str, program: str = PROGRAM, **environment: str) -> str:
    done = subprocess.run(
        [*command, "-c", program],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, **environment},
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


def emulator(architecture: str) -> str:
    found = shutil.which(f"qemu-{architecture}") or shutil.which(f"qemu-{architecture}-static")
    if found is None:
        pytest.skip(f"needs qemu-{architecture}: apt-get install qemu-user")
    return found


@pytest.mark.skipif(os.uname().machine != "x86_64", reason="runs this Python on an older processor of the same kind")
def test_x86_without_vnni() -> None:
    """Haswell has AVX2, whose int8 products saturate at 16 bits."""
    python = str(Path(sys.executable).resolve())
    path = os.pathsep.join(entry for entry in sys.path if entry)
    haswell = (emulator("x86_64"), "-cpu", "Haswell", python)
    assert answers(*haswell, PYTHONPATH=path) == answers(sys.executable)
    assert_the_grid_holds(answers(sys.executable, program=GRID), answers(*haswell, program=GRID, PYTHONPATH=path))


def test_aarch64() -> None:
    root = os.environ.get("LOOKBACK_AARCH64_ROOT")
    if not root:
        pytest.skip("needs LOOKBACK_AARCH64_ROOT: see make_aarch64_root.sh")
    command = (emulator("aarch64"), "-L", root, "-cpu", "cortex-a76", f"{root}/usr/bin/python3")
    there = {"PYTHONPATH": f"{ROOT}:{root}/packages", "PYTHONHOME": f"{root}/usr"}
    assert answers(*command, **there) == answers(sys.executable)
    assert_the_grid_holds(answers(sys.executable, program=GRID), answers(*command, program=GRID, **there))
