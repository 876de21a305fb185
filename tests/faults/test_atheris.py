"""Coverage-guided fuzzing, a minute for each reader, with the extra `fuzz`, which `make soak` installs."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

TARGETS = Path(__file__).with_name("atheris_targets.py")
SECONDS = 60


@pytest.mark.soak
@pytest.mark.parametrize("target", ["config", "feed", "map", "state", "journal", "mavlink"])
def test_coverage_guided(target: str, tmp_path: Path, seed: int, figures: Callable[[str], None]) -> None:
    if importlib.util.find_spec("atheris") is None:
        pytest.skip("atheris is not installed")
    limits = [f"-max_total_time={SECONDS}", f"-seed={seed % 2**31 or 1}", "-timeout=10", "-rss_limit_mb=2048"]
    done = subprocess.run(
        [sys.executable, str(TARGETS), target, str(tmp_path), *limits, f"-artifact_prefix={tmp_path}/"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    runs = re.findall(r"Done (\d+) runs in (\d+) second", done.stderr)
    assert runs, done.stderr[-1000:]
    figures(f"{runs[0][0]} runs in {runs[0][1]} s")
