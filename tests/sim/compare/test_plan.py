"""A plan that is wrong is one line that names the file and the key; the shipped plans are right."""

from __future__ import annotations

from pathlib import Path

import pytest

from edge.errors import ConfigError
from sim.compare.methods import METHODS
from sim.compare.plan import load_plan

PLANS = Path(__file__).parents[3] / "sim/compare/plans"

GOOD = """
title = "t"
methods = ["NSD-CR"]
sampling = { by = "frames" }
traverses = { here = { feed = "here" }, there = { feed = "there" } }
[[pairs]]
name = "p"
reference = "there"
query = "here"
truth = "rows"
length = 5
"""


@pytest.mark.parametrize("path", sorted(PLANS.glob("*.toml")), ids=lambda path: path.stem)
def test_shipped_plans_name_methods_and_scenarios_that_are_there(path: Path) -> None:
    plan = load_plan(path)
    named = [method.partition("@") for method in plan.methods]
    assert {row for row, _, _ in named} <= set(METHODS)
    assert {network for _, at, network in named if at} <= set(plan.networks)
    for traverse in plan.traverses.values():
        assert not traverse.scenario or (path.parent / traverse.scenario).is_file()


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('title = "t"', "titel = 1", "unknown key `titel`"),
        ("length = 5", "length = 0", r"pairs\[0\].length: expected a whole number >= 1"),
        ("length = 5", "length_m = 5.0", "by = .distance."),
        ("length = 5", "", "needs length"),
        ('"rows"', '"gps"', "'gps' is none of "),
        ('"rows"', '"anchors"', "two or more anchors"),
        ('"rows"', '"anchors"\nanchors = [[4, 1], [3, 2]]', "in order"),
        ('query = "here"', 'query = "nowhere"', "query: no 'nowhere'; there are here, there"),
        ('{ feed = "here" }', "{ }", "traverses.here: needs one of feed, feeds and scenario"),
        ('feed = "here"', 'feeds = ["a", "b"], last_row = 3', "last_row needs feed, not feeds"),
        ("length = 5", 'length = 5\ncalibration = "here"', "calibration needs another drive than the query"),
        ("title", "title = [", "not TOML"),
        ("length = 5", "length = 5\n[networks.x]", "networks.x: needs model or descriptors"),
        ('title = "t"', 'title = "t"\nseeds = [1]', "seeds: need a scenario for every traverse; here has none"),
    ],
)
def test_a_wrong_plan_is_one_line(tmp_path: Path, old: str, new: str, says: str) -> None:
    path = tmp_path / "plan.toml"
    path.write_text(GOOD.replace(old, new))
    with pytest.raises(ConfigError, match=says) as caught:
        load_plan(path)
    assert str(caught.value).startswith(str(path)) and "\n" not in str(caught.value)


def test_a_good_plan_is_read_and_a_missing_one_named(tmp_path: Path) -> None:
    (tmp_path / "plan.toml").write_text(GOOD)
    assert load_plan(tmp_path / "plan.toml").pairs[0].tolerance == 40.0
    with pytest.raises(ConfigError, match=r"nowhere\.toml: cannot read it"):
        load_plan(tmp_path / "nowhere.toml")


def test_a_plan_that_names_no_network_has_the_one_that_every_installation_has(tmp_path: Path) -> None:
    (tmp_path / "plan.toml").write_text(GOOD)
    assert {name: one.model for name, one in load_plan(tmp_path / "plan.toml").networks.items()} == {"grid": "grid"}


def test_each_pair_is_compared_on_each_road_and_counts_as_one_kind(tmp_path: Path) -> None:
    plan = GOOD.replace("feed =", "scenario =").replace('title = "t"', 'title = "t"\nseeds = [3, 8]')
    (tmp_path / "plan.toml").write_text(plan)
    found = load_plan(tmp_path / "plan.toml")
    assert [(one.name, one.kind) for one in found.pairs] == [("p, road 3", "p"), ("p, road 8", "p")]
    assert [found.traverses[one.query].seed for one in found.pairs] == [3, 8]
    assert [found.traverses[one.reference].scenario for one in found.pairs] == ["there", "there"]
