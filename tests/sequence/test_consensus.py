"""The place belief: what the votes of matches along the odometer add up to."""

from __future__ import annotations

import random
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.config import AcceptanceConfig, Config
from edge.reference_map import Drives, ModelKey
from edge.sequence import Direction
from edge.sequence.consensus import ConsensusSettings, PlaceBelief, PlaceConsensus, PlaceVote, probability
from edge_plugins.mapping.builder import Place
from sim.compare.temporary_map import MappedDrive, temporary_map

SETTINGS = ConsensusSettings()
STRONG = PlaceVote(
    drive=0,
    along_m=0.0,
    start_m=0.0,
    end_m=1000.0,
    direction="forward",
    uniqueness=1.2,
    sharpness=0.1,
    row_share=0.0,
)


def _drive(
    consensus: PlaceConsensus, votes: list[PlaceVote | None], *, from_m: float = 0.0, odometer: bool = True
) -> list[PlaceBelief | None]:
    """Beliefs of frames 2 m apart."""
    return [
        consensus.update(vote, from_m + 2.0 * frame if odometer else None) for frame, vote in enumerate(votes, start=1)
    ]


def _right(first_m: float, frames: int, vote: PlaceVote = STRONG) -> list[PlaceVote | None]:
    sign = 1 if vote.direction == "forward" else -1
    return [replace(vote, along_m=first_m + sign * 2.0 * frame) for frame in range(1, frames + 1)]


def _scattered(frames: int, seed: int = 1) -> list[PlaceVote | None]:
    """Matches as off the map: anywhere, and seldom unique."""
    rng = random.Random(seed)
    return [
        replace(STRONG, along_m=rng.uniform(0, 1000), uniqueness=1.02, sharpness=0.03, row_share=rng.random())
        for _ in range(frames)
    ]


def _last(beliefs: list[PlaceBelief | None]) -> PlaceBelief:
    last = beliefs[-1]
    assert last is not None
    return last


@pytest.mark.parametrize("direction", ["forward", "reverse"])
def test_matches_that_move_with_the_odometer_are_believed(direction: Direction) -> None:
    vote = replace(STRONG, direction=direction)
    belief = _last(_drive(PlaceConsensus(SETTINGS), _right(500.0, 40, vote)))
    assert belief.is_believed
    assert belief.direction == direction
    assert belief.along_m == pytest.approx(580.0 if direction == "forward" else 420.0)


def test_a_drive_that_was_matched_first_does_not_hold_back_the_one_that_agrees_with_it() -> None:
    """Two drives over one road: a few matches on one do not show that its places go along with the vehicle."""
    alone = _last(_drive(PlaceConsensus(SETTINGS), _right(500.0, 40)))
    on_two_drives: list[PlaceVote | None] = [
        replace(vote, drive=int(frame >= 4)) for frame, vote in enumerate(_right(500.0, 40)) if vote is not None
    ]

    def on_one_spot(drives: NDArray[np.int64], along_m: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.column_stack([np.zeros(len(drives)), along_m])

    both = _last(_drive(PlaceConsensus(SETTINGS, on_one_spot), on_two_drives))
    assert both.drive == 1
    assert both.confidence == pytest.approx(alone.confidence, abs=0.002)


def test_a_drive_that_came_by_twice_is_believed_where_its_passes_take_turns() -> None:
    """Out for 300 m, 200 m back, and out again, all in one drive: 200 m of the way home are there twice."""

    def north_m(along_m: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.interp(along_m, [0.0, 300.0, 500.0, 1000.0], [0.0, 300.0, 100.0, 600.0])

    def on_ground(drives: NDArray[np.int64], along_m: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.column_stack([np.zeros(len(drives)), north_m(along_m)])

    home = replace(STRONG, direction="reverse")
    at_m = np.arange(400.0, 0.0, -2.0)
    passes = [y if y < 100 or (y < 300 and y % 16 < 8) else y + 400.0 for y in at_m]
    beliefs = _drive(PlaceConsensus(SETTINGS, on_ground), [replace(home, along_m=along_m) for along_m in passes])
    assert all(belief and belief.is_believed for belief in beliefs[40:])
    twice = [(belief.along_m, y) for belief, y in zip(beliefs, at_m, strict=True) if belief and 100 < y < 300]
    believed_m, true_m = np.array(twice).T
    assert north_m(believed_m) == pytest.approx(true_m, abs=1.0), "not between the passes"


def test_a_place_of_half_the_evidence_is_as_probable_as_is_believed_by_default() -> None:
    assert probability(0.5) == AcceptanceConfig().confidence_from
    assert (probability(0.0), probability(1.0)) == (0.0, 1.0)


def test_one_match_is_not_believed() -> None:
    belief = _last(_drive(PlaceConsensus(SETTINGS), _right(500.0, 1)))
    assert not belief.is_believed


def test_matches_off_the_map_are_not_believed() -> None:
    beliefs = _drive(PlaceConsensus(SETTINGS), _scattered(300))
    assert not any(belief and belief.is_believed for belief in beliefs)


def test_a_place_that_stays_while_the_vehicle_moves_is_not_believed() -> None:
    """A landmark ahead looks alike from afar, but the matched place does not advance."""
    beliefs = _drive(PlaceConsensus(SETTINGS), [replace(STRONG, along_m=500.0)] * 100)
    assert not any(belief and belief.is_believed for belief in beliefs)


@pytest.mark.parametrize(("advance", "is_believed"), [(0.5, False), (0.75, True), (1.4, True), (1.7, False)])
def test_without_an_odometer_places_advance_as_the_lines_that_are_searched(advance: float, is_believed: bool) -> None:
    """Lines of slopes from 0.66 to 1.51 cannot follow another pace: they end where the vehicle is not."""
    votes: list[PlaceVote | None] = [replace(STRONG, along_m=100.0 + advance * 2.0 * frame) for frame in range(100)]
    beliefs = _drive(PlaceConsensus(SETTINGS), votes, odometer=False)
    assert any(belief and belief.is_believed for belief in beliefs) == is_believed


@pytest.mark.parametrize("frame_m", [2.0, 4.0, 6.0])
@pytest.mark.parametrize("map_m", [1.0, 2.0, 4.0])
def test_votes_may_differ_by_what_a_camera_sees_however_far_apart_the_places_are(map_m: float, frame_m: float) -> None:
    """What is recognized lies up to 15 m further ahead on some stretches than on others."""
    places = [Place(row, route_m=map_m * row) for row in range(9)]
    drive = MappedDrive(np.random.default_rng(0).random((9, 2, 96), np.float32), places, "front")
    with temporary_map([drive], ModelKey("made", "0" * 64, "fc6", 96)) as maps:
        settings = ConsensusSettings.of(Config(), Drives(maps, frame_m), frame_m / map_m)
    consensus = PlaceConsensus(settings)
    for at_m in np.arange(0.0, 400.0, frame_m):
        ahead_m = 15.0 if at_m % 100.0 < 50.0 else 0.0
        belief = consensus.update(replace(STRONG, along_m=at_m + ahead_m), at_m)
    assert belief is not None
    assert belief.confidence > 0.985
    assert abs(belief.along_m - at_m - 7.5) <= 10.0


def test_a_place_that_few_frames_support_is_not_believed() -> None:
    beliefs = _drive(PlaceConsensus(SETTINGS), _right(100.0, 100, replace(STRONG, row_share=0.3)))
    assert beliefs[-1] is None


def test_a_few_meters_are_not_enough_however_strong_the_matches() -> None:
    strongest = replace(STRONG, uniqueness=3.0, sharpness=1.0)
    believed = [
        belief is not None and belief.is_believed
        for belief in _drive(PlaceConsensus(SETTINGS), _right(500.0, 20, strongest))
    ]
    assert not any(believed[:4])
    assert all(believed[12:])


def test_a_drive_that_is_unlike_all_others_does_not_outweigh_them() -> None:
    """A few matches in the one night drive of a map are unique by far, wherever in it they lie."""
    consensus = PlaceConsensus(SETTINGS)
    right = _right(500.0, 60, replace(STRONG, uniqueness=1.1, sharpness=0.1))
    for at in range(20, 28):
        right[at] = replace(STRONG, drive=1, along_m=300.0 + 2.0 * at, uniqueness=3.0, sharpness=0.05)
    belief = _last(_drive(consensus, right))
    assert belief.drive == 0
    assert belief.is_believed


def test_matches_that_places_elsewhere_equal_are_never_believed() -> None:
    """On a street whose houses repeat: a mean uniqueness of 1.03 to 1.05, for 300 m; on others from 1.09."""
    votes = (_right(100.0, 150, replace(STRONG, uniqueness=one)) for one in (1.03, 1.05, 1.09))
    assert [_last(_drive(PlaceConsensus(SETTINGS), one)).is_believed for one in votes] == [False, False, True]


@pytest.mark.parametrize("what", ["go elsewhere", "are unlike", "stay at the end of the drive"])
def test_belief_ends_where_matches_speak_for_it_no_longer(what: str) -> None:
    """The drive ends at 1,000 m."""
    consensus, at_m = PlaceConsensus(SETTINGS), 780.0 if "end" in what else 100.0
    assert _last(_drive(consensus, _right(at_m, 100))).is_believed
    after: list[PlaceVote | None] = [replace(STRONG, along_m=1000.0)] * 30
    if what == "go elsewhere":
        after = _scattered(80)
    elif what == "are unlike":
        after = _right(at_m + 200.0, 30, replace(STRONG, row_share=0.3))
    beliefs = _drive(consensus, after, from_m=200.0)
    assert not any(belief and belief.is_believed for belief in beliefs[20:])


def test_a_believed_drive_does_not_contradict_the_one_that_follows() -> None:
    def first_belief(settled: bool) -> int:
        consensus = PlaceConsensus(SETTINGS)
        before = _right(880.0, 60) if settled else _scattered(60)
        _drive(consensus, [vote and replace(vote, uniqueness=1.2, sharpness=0.1) for vote in before])
        next_drive = replace(STRONG, drive=1)
        beliefs = _drive(consensus, _right(0.0, 120, next_drive), from_m=120.0)
        return next(k for k, belief in enumerate(beliefs) if belief and belief.is_believed and belief.drive == 1)

    assert first_belief(settled=True) < first_belief(settled=False)


@pytest.mark.parametrize("direction", ["forward", "reverse"])
def test_on_a_closed_lap_the_belief_goes_on(direction: Direction) -> None:
    vote = replace(STRONG, direction=direction, lap_m=1002.0)
    votes = [v and replace(v, along_m=v.along_m % 1002.0) for v in _right(500.0, 600, vote)]
    beliefs = _drive(PlaceConsensus(SETTINGS), votes)
    for belief, right in zip(beliefs[60:], votes[60:], strict=True):
        assert belief is not None
        assert right is not None
        assert belief.is_believed
        assert abs((belief.along_m - right.along_m + 501.0) % 1002.0 - 501.0) < 5.0
        assert -20.0 <= belief.along_m <= 1020.0


@pytest.mark.parametrize(
    ("frames", "advance_m", "odometer", "places"),
    [(120, 2.0, 1.05, 1), (1000, 0.5, 1.0, 1), (30, 4.0, None, 2)],
    ids=["reads a twentieth too much", "more votes than are kept", "is not there, and a frame in two was missed"],
)
def test_an_odometer_agrees_with_itself(frames: int, advance_m: float, odometer: float | None, places: int) -> None:
    consensus, belief = PlaceConsensus(SETTINGS), None
    for driven_m in advance_m * np.arange(1, frames + 1):
        vote = replace(STRONG, along_m=100 + driven_m)
        belief = consensus.update(vote, odometer and odometer * driven_m, places=places)
    assert belief is not None and belief.is_believed
    assert belief.along_m == pytest.approx(100 + driven_m, abs=2.0 if odometer != 1.05 else 10.0)


def test_an_odometer_that_was_counted_anew_does_not_move_the_votes() -> None:
    consensus = PlaceConsensus(SETTINGS)
    _drive(consensus, _right(100.0, 60), from_m=5000.0)
    belief = consensus.update(replace(STRONG, along_m=222.0), 0.0)
    assert belief is not None
    assert belief.is_believed
    assert belief.along_m == pytest.approx(222.0, abs=1.0)


def test_frames_without_a_match_move_the_belief_on() -> None:
    consensus = PlaceConsensus(SETTINGS)
    belief = _last(_drive(consensus, [*_right(100.0, 60), *[None] * 5]))
    assert belief.is_believed
    assert belief.along_m == pytest.approx(230.0)


def test_reset_forgets_every_vote() -> None:
    consensus = PlaceConsensus(SETTINGS)
    _drive(consensus, _right(100.0, 60))
    consensus.reset()
    assert consensus.update(None, 122.0) is None


def test_two_drives_over_one_road_speak_for_one_place() -> None:
    """The best match changes between the two from frame to frame; both put the vehicle on the same spot."""

    def positions_m(drives: NDArray[np.int64], along_m: NDArray[np.float64]) -> NDArray[np.float64]:
        # The second drive began 100 m before the first.
        return np.column_stack([along_m - 100.0 * drives, np.zeros(len(drives))])

    first, second = _right(300.0, 60), _right(400.0, 60, replace(STRONG, drive=1))
    votes = [pair[number % 2] for number, pair in enumerate(zip(first, second, strict=True))]
    belief = _last(_drive(PlaceConsensus(SETTINGS, positions_m), votes))
    assert belief.is_believed
    assert belief.along_m == pytest.approx(420.0 + 100.0 * belief.drive)
    assert not _last(_drive(PlaceConsensus(SETTINGS), votes)).is_believed
    elsewhere = [vote and replace(vote, along_m=vote.along_m + 200.0 * vote.drive) for vote in votes]
    assert not _last(_drive(PlaceConsensus(SETTINGS, positions_m), elsewhere)).is_believed


def test_where_one_of_two_drives_ends_the_other_is_followed() -> None:
    """The one that ends was recognized better, and says nothing of where the vehicle is beyond its end."""

    def positions_m(drives: NDArray[np.int64], along_m: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.column_stack([along_m, np.zeros(len(drives))])

    ends = replace(STRONG, end_m=400.0)
    goes_on = replace(STRONG, drive=1, uniqueness=1.1)
    votes: list[PlaceVote | None] = []
    for meters in range(302, 400, 2):
        votes.append(replace(goes_on if meters % 10 == 0 else ends, along_m=float(meters)))
    votes += _right(398.0, 40, goes_on)
    beliefs = _drive(PlaceConsensus(SETTINGS, positions_m), votes)
    assert _last(beliefs[:49]).drive == 0
    assert all(belief is not None and belief.drive == 1 for belief in beliefs[49 + 16 :])
    assert _last(beliefs).is_believed


def test_a_place_is_that_of_votes_with_weight() -> None:
    """A drive whose only votes say nothing agrees with what another drive's votes say there; it leads to no place."""

    def positions_m(drives: NDArray[np.int64], along_m: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.column_stack([along_m, np.zeros(len(drives))])

    sideways_m, nothing = 0.6 * SETTINGS.slack_m, replace(STRONG, drive=1, uniqueness=1.0)
    votes = [*_right(100.0 + sideways_m, 30), *_right(160.0 - sideways_m, 30), *_right(220.0, 30, nothing)]
    belief = _last(_drive(PlaceConsensus(SETTINGS, positions_m), votes))
    assert belief.drive == 0
    assert belief.along_m == pytest.approx(280.0, abs=2 * sideways_m)
