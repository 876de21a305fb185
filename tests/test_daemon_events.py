"""A drive is a list of events: the daemon writes it, and a bare estimator gives the same answers again."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest
from msgspec.structs import replace

from edge.errors import FeedError
from edge.localization import Fix, Refusal
from edge.localization.drive_file import read_drive, replay
from edge.localization.events import Frame, Maps, Own, Used
from edge.localization.position_estimator import Asked
from sim.evaluation.memoizing_network import MemoizingNetwork
from tests.golden.harness import cases, run_case

CASES = cases("run")


@pytest.fixture
def scratch(make_once: Callable[[str, Callable[[Path], object]], Path]) -> Path:
    return make_once("golden", lambda folder: None)


@pytest.mark.parametrize("folder", CASES, ids=lambda folder: folder.name)
def test_a_bare_estimator_answers_the_list_of_a_drive_as_the_daemon_did(
    folder: Path, scratch: Path, tmp_path: Path, network: MemoizingNetwork
) -> None:
    """Every fix with its level, and every refusal, in each of the recorded runs."""
    path = tmp_path / "list.drive"
    run_case(folder, scratch, network, own=tmp_path / "run", drive=path)
    config, entries = read_drive(path)
    kinds = Counter(type(entry) for _, entry in entries)
    assert {Frame, Own, Maps, Used, Asked} <= set(kinds)
    answers = list(replay(config, entries))
    assert len(answers) == kinds[Asked] > 50
    for t_ns, asked, now in answers:
        assert now == asked.answer, t_ns
    assert {type(now) for _, _, now in answers} == {Fix, Refusal}


def test_another_configuration_gives_other_answers(scratch: Path, tmp_path: Path, network: MemoizingNetwork) -> None:
    """What is compared above can differ."""
    path = tmp_path / "list.drive"
    run_case(CASES[0], scratch, network, own=tmp_path / "run", drive=path)
    config, entries = read_drive(path)
    strict = replace(config, gates=replace(config.gates, risk=1e-12))
    assert any(now != asked.answer for _, asked, now in replay(strict, entries))


def test_the_list_of_a_computer_that_lost_its_power_ends_with_its_last_whole_entry(
    scratch: Path, tmp_path: Path, network: MemoizingNetwork
) -> None:
    path, cut = tmp_path / "list.drive", tmp_path / "cut.drive"
    run_case(CASES[0], scratch, network, own=tmp_path / "run", drive=path)
    data = path.read_bytes()
    cut.write_bytes(data[: len(data) // 2])
    _, entries = read_drive(path)
    _, read = read_drive(cut)
    assert len(entries) // 4 < len(read) < len(entries)
    assert [t_ns for t_ns, _ in read] == [t_ns for t_ns, _ in entries[: len(read)]]


@pytest.mark.parametrize("data", [b"", b"drive", b"\x1f\x8b\x08\x00"], ids=["empty", "text", "cut off"])
def test_what_is_no_list_of_a_drive_is_rejected_with_its_name(data: bytes, tmp_path: Path) -> None:
    path = tmp_path / "list.drive"
    path.write_bytes(data)
    with pytest.raises(FeedError, match=r"list\.drive"):
        read_drive(path)
