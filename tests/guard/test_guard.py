"""As root, a test that runs the program with the default journal would write into that of the vehicle."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from edge.config import TelemetryConfig


def test_the_vehicles_own_journal_is_refused() -> None:
    with pytest.raises(AssertionError, match=r"a test would write /var/lib/lookback/events\.jsonl"):
        Path(TelemetryConfig().journal).write_text("")


def test_also_of_a_program_that_a_test_starts() -> None:
    command = [sys.executable, "-c", "import os; os.makedirs('/var/lib/lookback/a/folder')"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "AssertionError: a test would write /var/lib/lookback" in done.stderr
