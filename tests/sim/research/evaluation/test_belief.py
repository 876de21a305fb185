"""The bench of the place belief, on roads made of random descriptors."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from edge.config import AcceptanceConfig
from edge.sequence import DeadReckoningPosition
from sim.evaluation.metrics import Answers
from sim.research.evaluation.__main__ import main
from sim.research.evaluation.reliability import Confidences, rows_of
from sim.research.evaluation.roads import Cut, DriveDescriptors, believe, judge, kept

PLACES, SPACING_M = 220, 2.0


def road(seed: int) -> DriveDescriptors:
    """Neighbors a little alike, as on a road, which leads north."""
    rng = np.random.default_rng(seed)
    raw = rng.normal(size=(PLACES + 2, 2, 128))
    alike = np.asarray(np.maximum(raw[:-2] + raw[1:-1] + raw[2:], 0), np.float32)
    route_m = np.arange(0.0, PLACES) * SPACING_M
    return DriveDescriptors(alike, route_m, route_m, np.column_stack([np.zeros(PLACES), route_m]))


def way_home(of: DriveDescriptors, noise: float = 0.5) -> DriveDescriptors:
    """The same places backwards, on another day."""
    rng = np.random.default_rng(9)
    raw = of.raw[::-1] + noise * np.abs(rng.normal(size=of.raw.shape)).astype(np.float32)
    return DriveDescriptors(raw, of.route_m[::-1].copy(), of.driven_m, of.east_north_m[::-1].copy())


@pytest.mark.parametrize(("cut", "parts"), [("whole", 1), ("first half", 1), ("second half", 1), ("thirds", 2)])
def test_the_way_home_is_believed_where_it_is_mapped_and_nowhere_else(cut: Cut, parts: int) -> None:
    mapped, query = road(1), way_home(road(1))
    beliefs = believe(mapped, query, cut)
    mapped_m = np.concatenate([mapped.route_m[start:end] for start, end in kept(cut, PLACES)])
    believed = beliefs.confidence >= AcceptanceConfig().confidence_from
    assert np.abs(beliefs.along_m - query.route_m)[believed].max() <= 40.0
    on_map = np.isin(query.route_m, mapped_m)
    assert believed[on_map].mean() > 0.3
    judged = judge(query, mapped_m, beliefs, ahead_m=0.0)
    assert len(judged.first_m) == parts
    assert all(0 < first_m < 140 for first_m in judged.first_m)
    assert judged.belief.correct[np.nan_to_num(judged.belief.confidence) >= AcceptanceConfig().confidence_from].all()


def test_lines_of_half_a_sequence_are_believed_sooner_where_gps_reckoned_on_the_map_and_only_there() -> None:
    of, query = road(1), way_home(road(1), noise=2.0)
    beliefs, mapped_m = (
        believe(of, query, "first half", reckoned=query.reckoned(0.0, seed=1)),
        of.route_m[: PLACES // 2],
    )
    assert judge(query, mapped_m, beliefs, ahead_m=0.0).first_m[0] <= 16  # 22 m by whole sequences alone
    assert judge(query, mapped_m, beliefs.alone, ahead_m=0.0).first_m == [28.0]


def test_votes_of_halves_begin_where_the_reckoning_does() -> None:
    """Also where it begins again; without one they neither count nor are kept."""
    of, query, begins = road(1), way_home(road(1), noise=2.0), 114
    vague = [replace(one, sigma_m=1e6) for one in query.reckoned(-1.0, seed=1)]  # no place is likelier than another
    reckoned: dict[str, list[DeadReckoningPosition | None]] = {
        "always": [*vague],
        "late": [None] * begins + vague[begins:],
        "again": [*vague[: begins - 1], None, *vague[begins:]],
    }
    found = {name: believe(of, query, "first half", reckoned=one) for name, one in reckoned.items()}
    np.testing.assert_allclose(found["again"].confidence[begins:], found["late"].confidence[begins:], atol=1e-6)
    gained = {name: (one.confidence - one.by_votes)[begins:] for name, one in found.items()}
    assert gained["always"][0] > 0.3  # by votes from before
    assert gained["late"][0] == 0
    assert gained["late"][:5].max() > 0.2
    assert (found["late"].confidence[:begins] == found["late"].by_votes[:begins]).all()


def test_another_road_is_not_believed() -> None:
    beliefs = believe(road(1), way_home(road(2)), "whole")
    assert beliefs.confidence.max() < AcceptanceConfig().confidence_from


def test_a_cut_map_keeps_what_its_name_says() -> None:
    assert kept("whole", 9) == [(0, 9)]
    assert kept("first half", 9) == [(0, 4)]
    assert kept("second half", 9) == [(4, 9)]
    assert kept("thirds", 9) == [(0, 3), (6, 9)]


def test_frames_on_the_map_count_as_much_as_all_off_it() -> None:
    on_map = np.array([True, True, True, True, False])
    mapped = Answers(np.array([0.55, 0.55, 0.55, 0.95, 0.55]), np.array([True, True, False, True, False]), on_map)
    claims = Confidences.of(mapped, np.array([0.0, 0.0, 0.55, np.nan]))
    tenths = list(claims.tenths())
    # Three of four on the map, of which two are right, and two of five off it.
    assert tenths[5][1:] == pytest.approx((0.55, 2 / 4 / (3 / 4 + 2 / 5)))
    assert tenths[9][1:] == pytest.approx((0.95, 1.0))
    assert [count for count, _, _ in tenths] == [0, 0, 0, 0, 0, 5, 0, 0, 0, 1]
    rows = list(rows_of({"roads": claims}))
    assert rows[2:] == ["| 0.7 to 0.8 | - |", "| 0.8 to 0.9 | - |", "| 0.9 to 1.0 | 1, 0.95, 1.00 |"]


def test_a_table_goes_between_its_marks(tmp_path: Path) -> None:
    made, page = tmp_path / "made.md", tmp_path / "page.md"
    made.write_text("| a |\n|---|\n", encoding="utf-8")
    page.write_text("Before.\n<!-- benchmark: begin -->\nold\n<!-- benchmark: end -->\nAfter.\n", encoding="utf-8")
    main(["benchmark", "--made", str(made), "--page", str(page)])
    table = "<!-- benchmark: begin -->\n\n| a |\n|---|\n\n<!-- benchmark: end -->"
    assert page.read_text(encoding="utf-8") == f"Before.\n{table}\nAfter.\n"
