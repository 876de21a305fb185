"""The row Keypoints: the ten best places of a frame in the order of their inliers."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from edge.config import SamplingConfig
from sim.compare.plan import Pair, Plan, TraversePlan
from sim.compare.run import Folders, open_runner


def test_the_ten_best_places_are_put_in_the_order_of_their_inliers(shared: Path, tmp_path: Path) -> None:
    """In a corridor, where a place is known within one frame: 25 of 40 by keypoints, 17 by descriptors."""
    feeds, methods = shared / "feeds", ["NSD-single", "Keypoints"]
    plan = Plan(
        title="corridor",
        methods=methods,
        traverses={name: TraversePlan(feed=f"corridor_{name}", last_row=39) for name in ("reference", "query")},
        pairs=[Pair("p", "reference", "query", "rows", tolerance=1.0, length=1)],
        sampling=SamplingConfig(by="frames"),
    )
    runner = open_runner(plan, Folders(feeds, feeds, feeds, tmp_path))
    alone, by_inliers = (runner.run(plan.pairs[0], method) for method in methods)
    np.testing.assert_array_equal(np.sort(by_inliers.matches.ranked), np.sort(alone.matches.ranked))
    right = [int((outcome.error_of_best() <= 1.0).sum()) for outcome in (alone, by_inliers)]
    assert right[1] > right[0] + 5
    assert (by_inliers.matches.confidence == by_inliers.matches.confidence.round()).all()
    assert by_inliers.frame_ms > alone.frame_ms
