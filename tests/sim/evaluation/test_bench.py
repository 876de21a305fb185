"""The row named Lookback is what `lookback replay` does, frame by frame."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import msgspec

from edge.camera.feed import read_feed
from edge.config import AcceptanceConfig, Config, SamplingConfig
from edge.descriptor.network import Head, Network
from edge.map_command import build_map
from edge.recognizer import PlaceRecognizer
from edge.reference_map.store import open_map
from edge.replay import replay
from sim.evaluation.commands import open_bench
from sim.evaluation.plan import NetworkPlan, Pair, Plan, TraversePlan

LENGTH, TOLERANCE, FRAMES = 10, 5.0, 60


def test_the_evaluation_answers_as_the_recogniser_does(shared: Path, tmp_path: Path) -> None:
    feeds = shared / "feeds"
    plan = Plan(
        title="corridor",
        methods=["Lookback"],
        networks={"shipped": NetworkPlan()},
        traverses={name: TraversePlan(feed=f"corridor_{name}", last_row=FRAMES - 1) for name in ("reference", "query")},
        pairs=[Pair("p", "reference", "query", "rows", tolerance=TOLERANCE, length=LENGTH)],
        sampling=SamplingConfig(by="frames"),
    )
    outcome = open_bench(plan, feeds, feeds, tmp_path).run(plan.pairs[0], "Lookback")

    default = Config()
    config = msgspec.structs.replace(
        default,
        descriptor=msgspec.structs.replace(default.descriptor, region_width=plan.region_width, standing_change=0.0),
        sequence=msgspec.structs.replace(default.sequence, length=LENGTH),
        # The corridor's nominal metre is one frame.
        acceptance=AcceptanceConfig(window_m=2 * TOLERANCE),
    )
    reference, query = (
        replace(feed, rows=feed.rows[:FRAMES])
        for feed in (read_feed(feeds / "corridor_reference"), read_feed(feeds / "corridor_query"))
    )
    build_map([reference], tmp_path / "map", config.descriptor, plan.sampling)
    reference_map = open_map(tmp_path / "map")
    network = Network.load()
    recognizer = PlaceRecognizer(network, Head.load(network), reference_map, config)
    lines = list(replay(recognizer, query, plan.sampling, list(range(FRAMES))))

    assert [line.place if line.place is not None else -1 for line in lines] == outcome.matches.place.tolist()
    uniqueness = [line.uniqueness for line in lines[LENGTH - 1 :]]
    assert uniqueness == [round(float(value), 6) for value in outcome.matches.confidence[LENGTH - 1 :]]
