"""The bench of the place belief, on roads made of random descriptors."""

from __future__ import annotations

import numpy as np
import pytest

from edge.config import AcceptanceConfig
from sim.research.evaluation.roads import Cut, Described, believe, judge, kept

PLACES, SPACING_M = 220, 2.0


def road(seed: int) -> Described:
    """Neighbors a little alike, as on a road."""
    rng = np.random.default_rng(seed)
    raw = rng.normal(size=(PLACES + 2, 2, 128))
    alike = np.asarray(np.maximum(raw[:-2] + raw[1:-1] + raw[2:], 0), np.float32)
    route_m = np.arange(0.0, PLACES) * SPACING_M
    return Described(alike, route_m, route_m)


def way_home(of: Described, noise: float = 0.5) -> Described:
    """The same places backwards, on another day."""
    rng = np.random.default_rng(9)
    raw = of.raw[::-1] + noise * np.abs(rng.normal(size=of.raw.shape)).astype(np.float32)
    return Described(raw, of.route_m[::-1].copy(), of.driven_m)


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


def test_another_road_is_not_believed() -> None:
    beliefs = believe(road(1), way_home(road(2)), "whole")
    assert beliefs.confidence.max() < AcceptanceConfig().confidence_from


def test_a_cut_map_keeps_what_its_name_says() -> None:
    assert kept("whole", 9) == [(0, 9)]
    assert kept("first half", 9) == [(0, 4)]
    assert kept("second half", 9) == [(4, 9)]
    assert kept("thirds", 9) == [(0, 3), (6, 9)]
