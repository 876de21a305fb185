"""What is kept between runs: whole or not at all, and only where it fits."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from edge.descriptor import RunningStatistics
from edge.recognition.warm_start import PersistentTime, StateFile, StateKey

KEY = StateKey("m" * 64, "fc6", "left-right", 0.4, "h" * 64)
SHAPE = (2, 16)
NOW = PersistentTime(1_000_000.0, "boot-a", 500.0)
RANDOM = np.random.default_rng(3)
KEPT = RunningStatistics.of_another_run(120, RANDOM.normal(size=SHAPE), RANDOM.random(SHAPE), at_most=120)


def later(seconds: float, boot: str = "boot-a", unix_s: float | None = None) -> PersistentTime:
    return PersistentTime(NOW.unix_s + seconds if unix_s is None else unix_s, boot, NOW.boot_s + seconds)


def write(file: StateFile) -> None:
    file.write(KEPT, NOW)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "events.state"
    write(StateFile(path, KEY, SHAPE))
    return path


@pytest.mark.parametrize("change", ["model_sha256", "tap", "regions", "map_sha256"])
def test_of_another_model_cut_or_map_it_is_refused_in_one_line(
    file: Path, change: str, caplog: pytest.LogCaptureFixture
) -> None:
    assert StateFile(file, replace(KEY, **{change: "other"}), SHAPE).read(later(1), 1800) is None
    (record,) = caplog.records
    assert record.levelno == logging.WARNING
    assert record.getMessage() == f"{file}: ignored: made with another model, other regions or another map"


def test_of_another_shape_it_is_refused(file: Path) -> None:
    assert StateFile(file, KEY, (1, 32)).read(later(1), 1800) is None
    assert StateFile(file, KEY, (2, 8)).read(later(1), 1800) is None


def test_its_age_is_told_by_the_boots_own_clock_and_across_boots_by_the_wall_clock(file: Path) -> None:
    state = StateFile(file, KEY, SHAPE)
    ten_years_s = 3650 * 86400.0
    assert state.read(later(60, unix_s=NOW.unix_s + ten_years_s), 1800) is not None  # the wall clock was stepped
    assert state.read(later(1801), 1800) is None
    assert state.read(later(60, "boot-b"), 1800) is not None
    assert state.read(later(60, "boot-b", unix_s=NOW.unix_s - 1), 1800) is None  # from the future: no clock to trust


def test_a_disk_that_takes_nothing_costs_the_state_and_is_told_once(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    state = StateFile(tmp_path / "no-such-folder" / "events.state", KEY, SHAPE)
    write(state)
    write(state)
    (record,) = caplog.records
    assert "cannot write it: No such file" in record.getMessage()
