"""kill -9 while a drive is mapped: the map is whole each time, and goes on where it was."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from edge.reference_map import open_map
from edge_plugins.mapping.place_log import logs_in
from tests.faults.mapping_loop import open_live

pytestmark = pytest.mark.long

LOOP = Path(__file__).with_name("mapping_loop.py")
MOST_LOST = 5


@pytest.mark.parametrize("kills", [8, pytest.param(200, marks=pytest.mark.soak)])
def test_killed_while_mapping(
    kills: int, compile_shim: Callable[[str], Path], tmp_path: Path, seed: int, figures: Callable[[str], None]
) -> None:
    command = [sys.executable, str(LOOP), str(tmp_path), str(kills), str(seed)]
    environment = {**os.environ, "LD_PRELOAD": str(compile_shim("slow_disk_shim"))}
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    found = json.loads(done.stdout)
    places = found["places"]
    figures(
        f"{kills} kills, {places[-1]} places, {found['points'][-1]} with keypoints; at most {max(found['lost'])} lost"
        f" by a kill, {sum(found['cut'])} times a record was cut off"
    )
    assert len(places) == kills
    assert sum(found["cut"]) >= kills // 4, "so many kills have to meet a record"
    assert places == sorted(places) and found["points"] == sorted(found["points"]), "what was there before stays"
    assert max(found["lost"]) <= MOST_LOST
    mapped = open_live(tmp_path)
    assert mapped.status.places == mapped.searched.count == places[-1]
    mapped.store.close()
    assert len(logs_in(tmp_path / "maps")) == 1
    open_live(tmp_path, later_s=86_400.0).store.close()
    made = open_map(tmp_path / "maps" / mapped.status.name, every_file=True)
    assert made.header.places == places[-1]
    assert made.keypoints is not None and np.isfinite(made.keypoints["sigma"]).any(axis=1).sum() <= found["points"][-1]
    assert made.keypoints["descriptor"].any(axis=(1, 2)).sum() >= found["points"][-1] > 0
