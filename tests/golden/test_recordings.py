"""Recordings of the simulator, and the outputs that were right for them, but for the last digits (see `compare`).

Of drives whose pictures are rendered for the test, what is decided is equal; see `decisions`.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from edge.localization import Fix, NoFix
from edge.localization.drive_file import read_drive, replay
from edge.localization.events import AutopilotState, FixFeedback, ImageProcessed, MapUpdate
from edge.localization.position_estimator import FixResult
from sim.evaluation.memoizing_network import MemoizingNetwork
from tests.golden.compare import first_difference
from tests.golden.harness import EXPECTED, JOURNAL, SENT, cases, outputs_of


@pytest.fixture
def scratch(make_once: Callable[[str, Callable[[Path], object]], Path]) -> Path:
    """One for all workers, so that each map is built once."""
    return make_once("golden", lambda folder: None)


APART_M, METERS_A_DEGREE = 0.5, 110_574.0
"""Between positions of a rendered drive, then and now. Processors with and without AVX-512 render it and describe it
differently in the last bits: positions were up to 0.08 m apart, all that was decided was equal."""


OF_PARTS = "folder_of_maps", "tiles"
"""tests/commands/test_map_folders.py holds that such maps answer as the whole one does."""
REPLAYED = [pytest.param(one, marks=[pytest.mark.long] * (one.name in OF_PARTS)) for one in cases("replay")]
RENDERED = [pytest.param(folder, marks=pytest.mark.long) for folder in cases("drives")]
"""Rendered and described anew: four in five of the seconds that all goldens take."""


@pytest.mark.parametrize(
    "folder", [*REPLAYED, *cases("run"), *RENDERED], ids=lambda folder: f"{folder.parent.name}-{folder.name}"
)
def test_the_outputs_are_what_they_were(
    folder: Path, scratch: Path, network: MemoizingNetwork, golden_run: Callable[[Path], Path]
) -> None:
    """And of a run, a bare estimator gives the daemon's answers to the list of the drive."""
    if folder.parent.name == "drives":
        pytest.importorskip("panda3d", reason="needs the simulator's renderer (extra sim)")
    if folder.parent.name == "run":
        found = golden_run(folder)
        outputs = {name: (found / name).read_text(encoding="utf-8") for name in (JOURNAL, SENT)}
        a_bare_estimator_answers_as_the_daemon_did(found / "list.drive")
    else:
        outputs = outputs_of(folder, scratch, network)
    for name, now in outputs.items():
        expected = (folder / name).read_text(encoding="utf-8")
        is_rendered = folder.parent.name == "drives"
        old, new = (decisions(expected), decisions(now)) if is_rendered else (expected, now)
        if difference := first_difference(old, new):
            pytest.fail(f"{folder / name}: {difference}")
        if is_rendered:
            assert np.abs(times_s(now) - times_s(expected)).max() <= PICTURE_S
        apart_deg = np.abs(positions(now) - positions(expected))
        assert apart_deg.max(initial=0.0) * METERS_A_DEGREE <= APART_M


def a_bare_estimator_answers_as_the_daemon_did(drive: Path) -> None:
    """Every fix with its level, and every refusal."""
    config, entries = read_drive(drive)
    kinds = Counter(type(entry) for _, entry in entries)
    assert {ImageProcessed, AutopilotState, MapUpdate, FixFeedback, FixResult} <= set(kinds)
    answers = list(replay(config, entries))
    assert len(answers) == kinds[FixResult] and len(answers) > 50
    for t_ns, asked, now in answers:
        expected, answer = (msgspec.json.encode(each).decode() for each in (asked.answer, now))
        assert first_difference(expected, answer) is None, t_ns
    assert {type(now) for _, _, now in answers} == {Fix, NoFix}


DECIDED = ("event", "mavpackettype", "state", "why", "reason", "accepted", "emitted", "way")
TIMES = ("send_boot_s", "at_s")
PICTURE_S = 0.11
"""Between two pictures. Speeds by the camera differ by a hundredth between two processors, since OpenCV's sums do: so
the next picture may be the one that is far enough on."""


def of_each_kind(text: str) -> list[dict[str, Any]]:
    """The rows of a journal or of what was sent, by which record or message it is."""
    rows = [json.loads(line) for line in text.splitlines()]
    return sorted(rows, key=lambda row: (row.get("event", ""), row.get("mavpackettype", "")))


def decisions(text: str) -> str:
    """Of a journal or of what was sent, without the figures: which record or message, and why."""
    return "\n".join(json.dumps({key: row[key] for key in DECIDED if key in row}) for row in of_each_kind(text))


def times_s(text: str) -> NDArray[np.float64]:
    """When those were."""
    return np.array([row.get(key, 0.0) or 0.0 for row in of_each_kind(text) for key in TIMES])


def positions(text: str) -> NDArray[np.float64]:
    """Those that were sent, in degrees (n, 2)."""
    rows = [row for row in map(json.loads, text.splitlines()) if row.get("event") == "fix_sent"]
    return np.array([(row["lat_deg"], row["lon_deg"]) for row in rows])


def lines(kind: str, name: str) -> list[dict[str, Any]]:
    return [json.loads(line) for folder in cases(kind) for line in (folder / name).read_text().splitlines()]


def test_the_goldens_have_all_kinds_of_answers_in_them() -> None:
    """A golden that only says "nothing recognized" would hold nothing."""
    seen = lines("replay", EXPECTED)
    kinds = {(line["direction"], line["order"]) for line in seen if line["accepted"]}
    assert {("reverse", "same"), ("forward", "swapped")} <= kinds
    assert {True, False} == {line["accepted"] for line in seen if line["place"] is not None}
    assert any(line["emitted"] for line in seen)
    assert any(line.get("missed") for line in seen)
    journal = lines("run", JOURNAL)
    states = {line["state"] for line in journal if line["event"] == "state"}
    assert {"on the map", "off the map", "warming up"} <= states
    events = {line["event"] for line in journal}
    assert {"frame", "place", "fix_sent", "fix_withheld", "fix_answered", "link", "stopped"} <= events
    withheld = {line["reason"] for line in journal if line["event"] == "fix_withheld"}
    assert "not confirmed by another place yet" in withheld
    assert {"COMMAND_INT", "GLOBAL_POSITION_SENSOR"} <= {line["mavpackettype"] for line in lines("run", SENT)}


@pytest.mark.parametrize("folder", [*cases("run"), *cases("drives")], ids=lambda folder: str(folder.name))
def test_no_position_is_sent_after_the_state_says_off_the_map(folder: Path) -> None:
    state, sent = "", 0  # sent, or not needed
    for line in map(json.loads, (folder / JOURNAL).read_text().splitlines()):
        state = line["state"] if line["event"] == "state" else state
        if line["event"] == "fix_sent":
            sent += 1
            assert state == "on the map"
        sent += line.get("reason") == "no reset is needed"
    assert sent
