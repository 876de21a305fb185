"""Which frames stand for right and wrong answers, on a road of random descriptors; and the page that shows them."""

from __future__ import annotations

import re
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from sim.research.evaluation.pairs import LEAST, checksum_of_pair, pairs
from sim.research.evaluation.roads import DriveDescriptors, Drives
from sim.research.pictures import MADE_OF
from tests.common import ROOT

PLACES, SPACING_M = 300, 2.0


def test_each_case_shows_a_frame_of_its_kind() -> None:
    rng = np.random.default_rng(5)
    raw = np.maximum(rng.normal(size=(PLACES + 2, 2, 128)), 0)
    route_m = np.arange(0.0, PLACES) * SPACING_M
    ground_m = np.column_stack([np.zeros(PLACES), route_m])
    road = DriveDescriptors(np.asarray(raw[:-2] + raw[1:-1] + raw[2:], np.float32), route_m, route_m, ground_m)

    def driven(noise: float) -> DriveDescriptors:
        other = noise * np.abs(rng.normal(size=road.raw.shape))
        return replace(road, raw=np.asarray(road.raw[:, ::-1] + other, np.float32))

    drives: Drives = {(light, "forward"): driven(0.8) for light in ("day", "dusk", "night", "rain", "snow")}
    found = {one.name: one for one in pairs((road, drives))}
    for name in ("dusk", "night", "rain"):
        one = found[name]
        assert one.said.startswith("accepted, ") and (one.confidence or 0) >= LEAST
        assert abs(one.row - one.frame) * SPACING_M <= 40 and one.words.startswith("right: ")
    early = found["early"]
    assert early.said.startswith("not accepted, ") and abs(early.row - early.frame) * SPACING_M <= 40
    unmapped = found["unmapped"]
    assert unmapped.said == "not accepted" and PLACES / 3 < unmapped.frame < 2 * PLACES / 3
    assert not PLACES / 3 < unmapped.row < 2 * PLACES / 3


PAIRS = re.findall(
    r"^\| !\[\w+\]\(pictures/(pair_\w+\.jpg)\) .*\|$",
    page := (ROOT / "docs/back-to-back.md").read_text(encoding="utf-8"),
    re.MULTILINE,
)


@pytest.mark.parametrize("name", PAIRS)
def test_a_row_of_the_page_is_that_of_its_picture(name: str) -> None:
    """If this fails: python -m sim.research.evaluation pairs, with the seeds that the page names."""
    pictures = ROOT / "docs/pictures"
    (row,) = (line for line in page.splitlines() if f"pictures/{name})" in line)
    assert msgspec.json.decode((pictures / MADE_OF).read_bytes())[name] == checksum_of_pair(pictures, row)
    assert (pictures / name).stat().st_size < 30_000


def test_the_page_shows_right_and_wrong_answers() -> None:
    rows = [line for line in page.splitlines() if line.startswith("| ![")]
    assert len(rows) == len(PAIRS) >= 5
    said = re.findall(r"\| \w+: (accepted|not accepted)\b.*\| (right|wrong):", "\n".join(rows))
    assert {("accepted", "right"), ("not accepted", "right"), ("not accepted", "wrong")} <= set(said)
