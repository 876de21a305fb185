"""What is advised for drives whose answers are known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from edge.config import Config
from edge.feed import Feed, FeedHeader, FeedRow
from edge.feed.format import View
from edge.journal.records import FrameUsed
from sim.calibration.offset import Offset
from sim.evaluation.metrics import Answers
from sim.evaluation.recognition import Recognition, RecognitionScore
from sim.first_try.verdict import FailureSpan, TryResult, opposite_share, verdict

FRAMES = 100


def a_feed(name: str, view: View = "front", width: int = 320) -> Feed:
    rows = tuple(FeedRow("", row * 10**9, lat_deg=0.0, lon_deg=0.0) for row in range(FRAMES))
    return Feed(Path(name), FeedHeader(name, view, width, 240), rows)


def a_try(believed: range, correct: range, *, reverse: bool = False, on_map: range = range(FRAMES)) -> TryResult:
    """A straight road of 100 places 2 m apart, driven with a frame at each; everything else as it should be."""
    rows = np.arange(FRAMES)
    road_m = np.column_stack([2.0 * rows, np.zeros(FRAMES)])
    truth_m = road_m[::-1] if reverse else road_m
    flags = [np.isin(rows, numbers) for numbers in (believed, correct, on_map)]
    used = [FrameUsed(row, row, accepted=row in believed, place=row, confidence=0.7) for row in range(FRAMES)]
    states = ["warming up" if row < 16 else "on the map" if flags[0][row] else "off the map" for row in rows]
    seen = Recognition(a_feed("query"), used, states, np.zeros((FRAMES, 0), np.float32))  # type: ignore[arg-type]
    answers = Answers(np.full(FRAMES, 0.7), flags[1] & flags[2], flags[2])
    judged = RecognitionScore("query", rows, answers, answers, flags[0], np.zeros(FRAMES), 0.0, truth_m, road_m)
    gray, faults = np.full(FRAMES, 90.0), ("",) * FRAMES
    maps = SimpleNamespace(index=SimpleNamespace(places=FRAMES))
    return TryResult(a_feed("out"), a_feed("query"), maps, Config(), seen, judged, 40.0, gray, faults)  # type: ignore[arg-type]


def test_a_good_drive_needs_no_advice() -> None:
    found = verdict(a_try(range(20, 100), range(100)))
    assert found.headline == "Recognized: 80 % of the frames, 95 % after the start"
    assert found.advice == ()
    assert found.stretches == (FailureSpan(0, 15, "warming up: a place is searched from 16 frames on"),)


def test_frames_that_warm_up_again_count_after_the_start() -> None:
    """As between single pictures that keypoints recognize, which said 100 %."""
    tried = a_try(range(20, 100, 2), range(100))
    states = ["on the map" if row in range(20, 100, 2) else "warming up" for row in range(FRAMES)]
    found = verdict(replace(tried, seen=replace(tried.seen, states=states)))  # type: ignore[arg-type]
    assert found.headline == "Recognized in part: 40 % of the frames, 50 % after the start"


def test_wrong_places_come_before_everything_else() -> None:
    found = verdict(a_try(range(20, 100), range(90)))
    assert found.headline == "Not to be trusted: 10 of 80 accepted places are wrong"
    assert found.stretches[-1] == FailureSpan(90, 99, "accepted, but over 40 m off")


def test_each_reason_is_named_where_it_holds() -> None:
    tried = a_try(range(20, 50), range(100), on_map=range(80))
    gray = np.where(np.arange(FRAMES) >= 60, 20.0, 90.0)
    tried = replace(tried, gray=gray, faults=("",) * 70 + ("the image is frozen",) * 5 + ("",) * 25)
    found = verdict(tried)
    assert [(one.first, one.why) for one in found.stretches[1:]] == [
        (50, "not accepted: confidence below 0.92"),
        (60, "not accepted: confidence below 0.92, and the picture is dark"),
        (70, "the image is frozen"),
        (75, "not accepted: confidence below 0.92, and the picture is dark"),
        (80, "not on the mapped road: no place of the map within 40 m"),
    ]
    assert "20 % of the query is not on the mapped road" not in " ".join(found.advice)
    assert found.headline == "Recognized in part: 38 % of the frames on the mapped road, 47 % after the start"


@pytest.mark.parametrize(("view", "is_advised"), [("front", True), ("rear", False)])
def test_the_way_back_needs_a_camera_that_looks_the_other_way(view: View, is_advised: bool) -> None:
    tried = replace(a_try(range(0), range(0), reverse=True), reference=a_feed("out", view))
    assert tried.judged is not None
    assert opposite_share(tried.judged) == 1.0
    found = verdict(tried)
    assert found.headline == "Not recognized"
    assert ("driven against the reference" in found.advice[0]) is is_advised


def test_dark_pictures_and_another_camera_are_advised_of() -> None:
    tried = replace(a_try(range(0), range(0)), query=a_feed("query", width=480), gray=np.full(FRAMES, 12.0))
    advice = " ".join(verdict(tried).advice)
    assert "are dark (median gray level 12 of 255)" in advice
    assert "the pictures are 320 x 240 and 480 x 240" in advice


def test_an_upright_phone_is_advised_of() -> None:
    feed = a_feed("query", width=180)
    assert feed.header.height > feed.header.width
    tried = replace(a_try(range(20, 100), range(100)), query=feed)
    assert any("the pictures of query are upright (180 x 240)" in one for one in verdict(tried).advice)


def test_without_positions_the_recordings_that_lack_them_are_named() -> None:
    nowhere = tuple(FeedRow("", row.stamp_ns) for row in a_feed("query").rows)
    tried = replace(a_try(range(20, 100), range(100)), judged=None, query=replace(a_feed("query"), rows=nowhere))
    found = verdict(tried)
    assert found.headline == "Recognized: 80 % of the frames, 95 % after the start"
    assert "whether they are right is not known" in found.facts[1]
    assert found.advice[0].startswith("no positions in query:")


def test_places_that_lie_too_far_ahead_show_times_that_differ() -> None:
    """100 frames, one a second: 2 m each."""
    rows = tuple(replace(row, distance_m=2.0 * number) for number, row in enumerate(a_feed("query").rows))
    far = Offset("reverse", "same", 50, 0, 40.0, 1.0, 2.0, 0.5, 1.0)
    tried = replace(a_try(range(20, 100), range(100)), query=replace(a_feed("query"), rows=rows), offsets=(far,))
    (advice,) = verdict(tried).advice
    assert "lies 40 m ahead though both cameras see the same scene" in advice
    assert "by 20.0 s together" in advice
    opposed = replace(far, order="swapped")
    assert not verdict(replace(tried, offsets=(opposed,))).advice


def test_a_short_drive_is_advised_of_with_the_frames_that_it_has() -> None:
    tried = a_try(range(0), range(0))
    few = replace(tried.seen, used=tried.seen.used[:50], states=tried.seen.states[:50])
    advice = verdict(replace(tried, seen=few, judged=None, gray=tried.gray[:50])).advice[0]
    assert advice.startswith("query has 50 places, and two sequences are 80: record a longer drive, or use more")
    maps = SimpleNamespace(index=SimpleNamespace(places=50))
    both = replace(tried, seen=few, judged=None, gray=tried.gray[:50], maps=maps)  # type: ignore[arg-type]
    advice = verdict(both).advice[0]
    assert advice.startswith("out has 50 places and query has 50 places, and two sequences are 80: record a longer")
