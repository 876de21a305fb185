"""What must hold of every position, over seeded drives without pictures: the cases in which one was once wrong.

Two drives of each case; in full (`make soak`) fifty. docs/integrity.md names these tests.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.localization import Fix, NoFix
from edge.localization.drive_file import replay
from edge.localization.position_estimator import FixResult
from tests.localization.route_bench import Bench, Result
from tests.localization.route_course import Course, Stretch

WHOLE = (Stretch(0.0, 1200.0),)


def shifted(rng: np.random.Generator, by_m: float, *stretches: tuple[float, float]) -> tuple[Stretch, ...]:
    """Stretches whose positions are all wrong by the same vector of that length."""
    angle = rng.uniform(0, 2 * math.pi)
    return tuple(Stretch(*one, by_m * math.sin(angle), by_m * math.cos(angle)) for one in stretches)


def off_road(how: str) -> Callable[[np.random.Generator], Course]:
    return lambda rng: Course(off_at_m=float(rng.uniform(400, 800)), off_how=how)


def one_stretch(rng: np.random.Generator) -> Course:
    begins_m = float(rng.uniform(0, 960))
    return Course(stretches=(Stretch(begins_m, begins_m + 220.0),))


def alias(rng: np.random.Generator) -> Course:
    begins_m = float(rng.uniform(300, 800))
    return Course(stretches=(Stretch(0.0, 200.0),), alias=(begins_m, begins_m + 128.0), alias_from_m=30.0)


def false_stretch(length_m: float, gps: bool = True) -> Callable[[np.random.Generator], Course]:
    """One stretch is wrong by 300 m, and those before and after it are right."""

    def course(rng: np.random.Generator) -> Course:
        false = shifted(rng, 300.0, (350.0, 350.0 + length_m))
        return Course(stretches=(Stretch(0.0, 310.0), *false, Stretch(390.0 + length_m, 1200.0)), gps=gps)

    return course


def only_false(length_m: float, gps: bool) -> Callable[[np.random.Generator], Course]:
    return lambda rng: Course(stretches=shifted(rng, 300.0, (100.0, 100.0 + length_m)), gps=gps)


def drives_disagree(rng: np.random.Generator) -> Course:
    return Course(stretches=(Stretch(0.0, 600.0), *shifted(rng, 40.0, (600.0, 1200.0))))


def drives_of_5_m(rng: np.random.Generator) -> Course:
    """The second drive of the map is wrong by what the first is, and once more."""
    east_m, north_m = rng.normal(0.0, 5 / math.sqrt(2), 2)
    second = Stretch(600.0, 1200.0, float(east_m), float(north_m), 5 * math.sqrt(2))
    return Course(stretches=(Stretch(0.0, 600.0, sigma_m=5.0), second))


RIGHT: dict[str, Callable[[np.random.Generator], Course]] = {
    "the whole road": lambda rng: Course(),
    "it steers itself": lambda rng: Course(steers=True),
    "one stretch": one_stretch,
    "turn-off by 90 degrees": off_road("turn -90"),
    "U-turn": off_road("turn 180"),
    "stop for 45 s": off_road("stop 45"),
    "reversing at 2 m/s": off_road("reverse 2"),
    "reversing at 4 m/s": off_road("reverse 4"),
    "ferry": off_road("ferry 2000"),
    "alias": alias,
    "false stretch of 140 m": false_stretch(140.0),
    "false stretch of 260 m": false_stretch(260.0),
    "false stretch of 400 m": false_stretch(400.0),
    "false stretch of 260 m, no GPS from boot": false_stretch(260.0, gps=False),
    "no GPS from boot": lambda rng: Course(gps=False),
    "two drives that disagree by 40 m": drives_disagree,
    "a map of 5 m accuracy": lambda rng: Course(stretches=(Stretch(0.0, 1200.0, sigma_m=5.0),)),
    "two drives of 5 and 7 m accuracy": drives_of_5_m,
    "odometer -3 %, heading 3 degrees": lambda rng: Course(scale=-0.03, heading_deg=3.0),
    "odometer +3 %, heading -3 degrees": lambda rng: Course(scale=0.03, heading_deg=-3.0),
}
ODD: dict[str, Callable[[np.random.Generator], Course]] = {
    "odometer -15 %": lambda rng: Course(scale=-0.15),
    "odometer +12 %": lambda rng: Course(scale=0.12),
}
FALSE: dict[str, Callable[[np.random.Generator], Course]] = {
    "140 m wrong by 300 m": only_false(140.0, gps=True),
    "400 m wrong by 300 m": only_false(400.0, gps=True),
    "140 m wrong by 300 m, no GPS from boot": only_false(140.0, gps=False),
    "400 m wrong by 300 m, no GPS from boot": only_false(400.0, gps=False),
    "all wrong by 40 m": lambda rng: Course(stretches=shifted(rng, 40.0, (0.0, 1200.0))),
    "laps of 120 m": lambda rng: Course(
        road_m=120.0, laps=8, stretches=shifted(rng, 150.0, (0.0, 60.0), (60.0, 120.0)), gps=False
    ),
}


def unaligned(begins_m: float, late_m: float, gps: bool = True, has_odometer: bool = False) -> Course:
    """A recording whose pictures are late as a whole; nobody knows how well they were laid over its positions.

    has_odometer: whether the log has one, which agrees with the positions.
    """
    stretch = Stretch(begins_m, 1160.0, has_odometer=has_odometer, whole_sigma_m=None, late_m=late_m)
    return Course(stretches=(stretch,), gps=gps)


IN_FULL = pytest.mark.parametrize("count", [2, pytest.param(50, marks=pytest.mark.soak)], ids=["two", "in full"])


LISTED = "false stretch of 260 m"
LIKE_OTHERS = {
    *("one stretch", "U-turn", "reversing at 2 m/s", "false stretch of 400 m", "two drives of 5 and 7 m accuracy"),
    *("false stretch of 260 m, no GPS from boot", "odometer +3 %, heading -3 degrees"),
}
"""They differ by a value from others, and are driven by `make test-long`."""
MARKS = {LISTED: [pytest.mark.soak], **{one: [pytest.mark.long] for one in LIKE_OTHERS}}


def driven(
    course: Callable[[np.random.Generator], Course], seed: int, folder: Path, *, is_stream: bool = False
) -> Bench:
    one = Bench(course(np.random.default_rng([seed, 9])), seed, folder, is_stream=is_stream)
    one.run()
    return one


def drives(course: Callable[[np.random.Generator], Course], count: int, folder: Path) -> list[Result]:
    return [driven(course, seed, folder).result for seed in range(count)]


def check_right(results: list[Result], most: float = 1.2) -> None:
    """most: the greatest rms of errors over standard deviations."""
    sigmas = np.array([value for result in results for value in result.sigmas])
    assert len(sigmas) > 2 * len(results)
    assert sigmas.max() <= 4.0
    assert np.mean(sigmas > 3.0) <= 0.003
    assert 0.45 <= np.sqrt(np.mean(sigmas**2)) <= most
    for result in results:
        # The last position may be some meters wrong where the drive is over soon after.
        assert np.median(result.own_m) <= 1.05 * np.median(result.alone_m) + 5.0, "never worse than without fixes"


def check_soon_after(results: list[Result], false_m: float) -> None:
    """The next stretch begins 40 m after the false one, and a line of 80 m must lie on it."""
    for result in results:
        assert min(at_m for at_m in result.known_at_m if at_m > false_m) <= false_m + 200.0


def check_odd(results: list[Result]) -> None:
    """Wrong by far more than is assumed: positions only until that is found, and none that is far off."""
    for result in results:
        assert not result.sigmas or max(result.sigmas) <= 4.0
        assert np.median(result.own_m) <= 1.05 * np.median(result.alone_m) + 5.0, "never worse than without fixes"


def check_false(results: list[Result]) -> None:
    assert not any(result.sigmas for result in results)


@pytest.mark.parametrize("has_odometer", [False, True], ids=["", "with an odometer"])
@pytest.mark.parametrize(("begins_m", "gps"), [(520.0, True), (0.0, False)], ids=["after 450 m", "no GPS from boot"])
def test_a_recording_that_nobody_aligned_is_never_more_certain_than_it_may_be_off(
    begins_m: float, gps: bool, has_odometer: bool, tmp_path: Path
) -> None:
    """It confirms itself over hundreds of meters; with the sigma of a known one positions are 7 of them off."""
    results = [Bench(unaligned(begins_m, 30.0, gps, has_odometer), seed, tmp_path).run() for seed in range(2)]
    sigmas = [sigma for result in results for sigma in result.sigmas]
    bounded = [one for result in results for one in result.bounded]
    assert sigmas and max(sigmas) <= 4.0
    assert bounded and not any(one.is_exceeded for one in bounded)


@IN_FULL
@pytest.mark.parametrize("name", [pytest.param(one, marks=MARKS.get(one, [])) for one in RIGHT])
def test_positions_are_as_good_as_they_say(name: str, count: int, tmp_path: Path) -> None:
    # Without GPS from boot there are few positions before places have confirmed each other; an alias follows 200 m.
    few = "no GPS from boot" in name or name == "alias"
    results = drives(RIGHT[name], max(count, 4) if few else count, tmp_path)
    # A heading that is wrong by 1.5 standard deviations on every drive.
    check_right(results, 1.5 if "heading" in name else 1.2)
    if name == "false stretch of 140 m":
        check_soon_after(results, 490.0)


@IN_FULL
@pytest.mark.parametrize("course", ODD.values(), ids=ODD.keys())
def test_an_odometer_that_is_wrong_by_far_moves_nothing_far(
    course: Callable[[np.random.Generator], Course], count: int, tmp_path: Path
) -> None:
    check_odd(drives(course, count, tmp_path))


@IN_FULL
@pytest.mark.parametrize("course", FALSE.values(), ids=FALSE.keys())
def test_no_false_place_is_published(
    course: Callable[[np.random.Generator], Course], count: int, tmp_path: Path
) -> None:
    check_false(drives(course, count, tmp_path))


@pytest.mark.parametrize("is_stream", [False, True], ids=["resets", "a stream"])
def test_positions_beside_a_false_stretch_are_as_good_as_they_say_and_its_list_gives_them_again(
    is_stream: bool, tmp_path: Path
) -> None:
    """A stream as PX4 follows it, and resets."""
    benches = [driven(RIGHT[LISTED], seed, tmp_path, is_stream=is_stream) for seed in range(2)]
    check_right([one.result for one in benches])
    one = benches[0]
    answers = [entry.answer for _, entry in one.events if isinstance(entry, FixResult)]
    assert sum(isinstance(answer, Fix) for answer in answers) > (50 if is_stream else 0)
    assert len({answer.reason for answer in answers if isinstance(answer, NoFix)}) > 2
    assert [answer for _, _, answer in replay(one.config, one.events)] == answers


def test_positions_of_a_stream_are_as_good_as_they_say(tmp_path: Path) -> None:
    """As a PX4 follows them that steers by them."""
    check_right([driven(RIGHT["it steers itself"], seed, tmp_path, is_stream=True).result for seed in range(2)])


def offs_m(course: Course, folder: Path) -> NDArray[np.float64]:
    return np.concatenate([Bench(course, seed, folder).run().off_m for seed in range(2)])


@pytest.fixture(scope="module")
def alone_m(tmp_path_factory: pytest.TempPathFactory) -> NDArray[np.float64]:
    """Errors by looks at the only drive of a road."""
    return offs_m(Course(poses=True), tmp_path_factory.mktemp("alone"))


@pytest.mark.parametrize(
    ("others", "pose_segments"),
    [((False,), (1,)), ((True,), (1,)), ((False, True, True), (0, 1, 2, 3))],
    ids=["of the other drive", "of one the other way", "of four"],
)
def test_poses_on_any_drive_of_a_road_are_as_good_as_on_the_only_one(
    others: tuple[bool, ...], pose_segments: tuple[int, ...], alone_m: NDArray[np.float64], tmp_path: Path
) -> None:
    """Lines are of the first drive. Before, the estimate began anew at each change: 4.6 m off (95 %), and not 1.2."""
    one = Stretch(0.0, 1200.0)
    stretches = one, *(replace(one, backward=backward) for backward in others)
    together_m = offs_m(Course(poses=True, stretches=stretches, pose_segments=pose_segments), tmp_path)
    assert np.percentile(together_m, 95) < np.percentile(alone_m, 95) + 0.5


@pytest.mark.parametrize(
    ("late_s", "late_rows", "speed_mps"),
    [(0.5, 0, 8.0), (-0.5, 0, 8.0), (0.3, 0, 15.0), (0.0, 2, 8.0), (0.0, -2, 8.0)],
    ids=["frames", "early frames", "fast", "rows", "early rows"],
)
def test_poses_that_are_4_m_late_are_within_what_positions_say(
    late_s: float, late_rows: int, speed_mps: float, tmp_path: Path
) -> None:
    """By frames that are so old and do not say so, or keypoints of another row: about 1.4 m is what is said.

    Before the age of pictures was in the state, frames were up to 4.4 sigma off.
    """
    course = Course(poses=True, late_s=late_s, late_rows=late_rows, speed_mps=speed_mps)
    sigmas = Bench(course, 3 if late_s else 0, tmp_path).run().sigmas
    assert len(sigmas) > 60
    assert np.sqrt(np.mean(np.square(sigmas))) > 1.5
    assert max(sigmas) < 4.0


@pytest.mark.parametrize(
    ("from_m", "to_m", "by_m"),
    [(300.0, 600.0, 12.0), (300.0, 800.0, 25.0), (500.0, 501.0, 6.0), (150.0, 1050.0, 24.0), (300.0, 1000.0, 28.0)],
    ids=["12", "25", "step", "most of it", "over half"],
)
def test_on_a_map_whose_gps_crept_poses_are_as_good_as_they_say(
    from_m: float, to_m: float, by_m: float, tmp_path: Path
) -> None:
    """By less than counts as wrong. As certain as on other maps, they were up to 18.6 sigma off."""
    crept = Stretch(0.0, 1200.0, has_odometer=True, crept=(from_m, to_m, 0.6 * by_m, 0.8 * by_m))
    result = Bench(Course(poses=True, stretches=(crept,)), 0, tmp_path).run()
    assert len(result.sigmas) > 100
    assert max(result.sigmas) < 3.0
    assert not any(one.is_exceeded for one in result.bounded)
