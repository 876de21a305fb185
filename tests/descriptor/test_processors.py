"""The same picture gives the same bytes on every processor: regions and fc6 here, and on emulated processors.

Emulation needs qemu-user (Debian: apt-get install qemu-user). For aarch64 it also needs a folder with Python and our
packages for it, which make_aarch64_root.sh beside this file makes, named by LOOKBACK_AARCH64_ROOT.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

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


def answers(*command: str, **environment: str) -> str:
    done = subprocess.run(
        [*command, "-c", PROGRAM],
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
    emulated = answers(emulator("x86_64"), "-cpu", "Haswell", python, PYTHONPATH=path)
    assert emulated == answers(sys.executable)


def test_aarch64() -> None:
    root = os.environ.get("LOOKBACK_AARCH64_ROOT")
    if not root:
        pytest.skip("needs LOOKBACK_AARCH64_ROOT: see make_aarch64_root.sh")
    command = (emulator("aarch64"), "-L", root, "-cpu", "cortex-a76", f"{root}/usr/bin/python3")
    emulated = answers(*command, PYTHONPATH=f"{ROOT}:{root}/packages", PYTHONHOME=f"{root}/usr")
    assert emulated == answers(sys.executable)
