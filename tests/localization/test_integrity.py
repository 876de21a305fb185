"""The decision on a position: each rule, and the argument from its probability of being of another place."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import msgspec
import pytest

from edge.config import GatesConfig
from edge.geodesy import VehiclePosition
from edge.localization import Decision, Displacement, Integrity, Limits, PlaceFix, ProtectionLevel, Report, Situation
from edge.localization.bound import OwnPosition, Reckoned
from edge.localization.claims import Claim
from edge.localization.integrity import UNNOTICED, distance_from, wrong_probability
from edge.localization.refusals import RULES, Reason, as_table

S = 1_000_000_000
NOW_NS = 100 * S
METRE_DEG = 1 / 110_574  # of latitude, at the equator
FIX = PlaceFix(NOW_NS - S, 7, 0.0, 10.0, 0.0, 3.0, 2.0, "forward", "same", 1.3, "street", matches=5, confidence=0.9)
OWN = VehiclePosition(NOW_NS - S, 0.0, 10.0, 20.0, 0.0, 10.0)
MOVING = Situation(NOW_NS, "not healthy", 10.0, OWN, 4.0, True, None, Displacement(1, 0.0, 0.0))


def decide(fix: PlaceFix = FIX, one: Integrity | None = None, gates: GatesConfig | None = None, **now: Any) -> Decision:
    """The decision on a fix that was observed."""
    one, situation = one or Integrity(gates or GatesConfig()), replace(MOVING, **now)
    one.observe(fix, situation)
    return one.decide(fix, situation, Limits(1.0, 5.0))


def why_not(decision: Decision) -> Reason | None:
    return decision.refusal.reason if decision.refusal else None


def reason(fix: PlaceFix = FIX, one: Integrity | None = None, gates: GatesConfig | None = None, **now: Any) -> Any:
    return why_not(decide(fix, one, gates, **now))


def drive(one: Integrity, meters: range, off_m: float = 0.0, recording: str = "", **now: Any) -> list[Any]:
    """Why not, of the decisions."""
    return [why_not(decision) for decision in decisions(one, meters, off_m, recording, **now)]


def decisions(
    one: Integrity, meters: range, off_m: float = 0.0, recording: str = "", fix: PlaceFix = FIX, **now: Any
) -> list[Decision]:
    """On fixes every 10 m on the way north, wrong by `off_m`; the autopilot is where the truth is."""
    decided = []
    for driven_m in meters[::10]:
        seen = msgspec.structs.replace(fix, lat_deg=(driven_m + off_m) * METRE_DEG, recording=recording)
        position = replace(OWN, lat_deg=driven_m * METRE_DEG)
        moved = Displacement(1, 0.0, float(driven_m))
        decided.append(decide(seen, one, **{"position": position, "displacement": moved, **now}))
    return decided


def test_a_good_fix_passes() -> None:
    assert reason() is None


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"gps": "healthy"}, "GPS is healthy"),
        ({"gps": "unknown"}, "GPS is unknown"),
        ({"speed_mps": 0.2}, "standing"),
        ({"speed_mps": None}, "the speed is not known"),
        ({"speed_mps": math.nan}, "the speed is not known"),
        ({"displacement": None}, "the displacement is not known"),
        ({"last_sent_ns": NOW_NS - S // 2}, "too soon"),
        ({"now_ns": NOW_NS + 5 * S}, "too old"),
        ({"now_ns": NOW_NS - 2 * S}, "too old"),
    ],
)
def test_situations_in_which_nothing_is_published(changes: dict[str, Any], why: str) -> None:
    assert reason(**changes) == why


def test_gps_does_not_matter_where_fixes_are_wanted_with_it() -> None:
    assert reason(gates=GatesConfig(with_gps=True), gps="healthy") is None


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"lat_deg": None, "lon_deg": None}, "no position in the map"),
        ({"lat_deg": math.nan}, "no position in the map"),
        ({"sigma_along_m": math.inf}, "no position in the map"),
        ({"disputed": True}, "the newest matches disagree"),
        ({"lat_deg": 16 * METRE_DEG}, "not confirmed by another place yet"),
        ({"lat_deg": 201 * METRE_DEG}, "impossibly far"),
    ],
)
def test_fixes_that_are_not_published(changes: dict[str, Any], why: str) -> None:
    assert reason(msgspec.structs.replace(FIX, **changes)) == why


@pytest.mark.parametrize("unknown", [{"position": None}, {"uncertainty_m": None}])
def test_where_nothing_is_known_of_the_autopilot_one_stretch_is_never_enough(unknown: dict[str, Any]) -> None:
    one = Integrity(GatesConfig())
    assert set(drive(one, range(0, 490), **unknown)) == {"not confirmed by another place yet"}
    assert drive(one, range(600, 620), recording="second", **unknown)[-1] is None, "another one confirms it"


def test_far_from_an_origin_that_bounds_nothing_two_stretches_confirm_each_other() -> None:
    """After a reboot without GPS the autopilot's position is its origin: 300 m off here, beyond `max_move_m`."""
    one = Integrity(GatesConfig())
    found = [
        drive(one, meters, off_m=300.0, recording=recording, uncertainty_m=None, bound_by_gps=False)
        for meters, recording in ((range(0, 490), ""), (range(600, 620), "second"))
    ]
    assert set(found[0]) == {"not confirmed by another place yet"}
    assert found[1][-1] is None
    assert reason(msgspec.structs.replace(FIX, lat_deg=300 * METRE_DEG)) == "impossibly far", "it is held to a bound"


def test_an_autopilot_that_drifts_onto_a_shifted_map_does_not_confirm_it() -> None:
    """All of the map is 40 m off; by its own drift, the autopilot is there after 1.2 km."""
    one = Integrity(GatesConfig())
    for driven_m in range(0, 1200, 10):
        fix = msgspec.structs.replace(FIX, lat_deg=(driven_m + 40.0) * METRE_DEG)
        position = replace(OWN, lat_deg=(driven_m + 40.0 * driven_m / 1200) * METRE_DEG)
        moved, uncertainty_m = Displacement(1, 0.0, float(driven_m)), 4.0 + 0.03 * driven_m
        assert reason(fix, one, position=position, displacement=moved, uncertainty_m=uncertainty_m) is not None


def test_a_long_drive_confirms_itself_after_500_meters() -> None:
    decisions = drive(Integrity(GatesConfig()), range(0, 600), uncertainty_m=None)
    assert decisions.index(None) == 54, "the observations are 60 m apart"


def test_another_stretch_counts_by_displacement_not_by_what_was_driven() -> None:
    """Laps of 80 m between two drives of the map: nowhere 100 m from where they began."""
    one = Integrity(GatesConfig())
    for lap in range(10):
        there = drive(one, range(0, 40), recording=str(lap % 2), uncertainty_m=None)
        back = drive(one, range(40, 0, -1), recording=str(1 - lap % 2), uncertainty_m=None)
        assert None not in there + back


@pytest.mark.parametrize("gap_m", [24, 60])
def test_two_segments_of_one_recording_do_not_confirm_each_other(gap_m: int) -> None:
    """Their map is 150 m wrong over 410 m, with a gap; another recording on other ground would confirm it."""
    one, middle_m = Integrity(GatesConfig()), 205 + gap_m
    assert None not in drive(one, range(0, 205), off_m=150.0, recording="out", uncertainty_m=None)
    assert None not in drive(one, range(middle_m, middle_m + 205), off_m=150.0, recording="out", uncertainty_m=None)
    assert drive(one, range(480, 560), off_m=150.0, recording="another", uncertainty_m=None)[-1] is None


@pytest.mark.parametrize(("checked_m", "confirmed_m"), [(0.0, 540), (500.0, 540), (530.0, 180)])
def test_a_drive_that_moved_as_its_vehicle_is_wrong_as_a_whole_or_not(checked_m: float, confirmed_m: int) -> None:
    """A part of it that is too short to confirm itself cannot be wrong alone; a short drive may be wrong as a whole."""
    fix = msgspec.structs.replace(FIX, checked_m=checked_m)
    published = decisions(Integrity(GatesConfig()), range(0, 600), fix=fix, uncertainty_m=None)
    assert 10 * [one.refusal for one in published].index(None) == confirmed_m, "the observations are 60 m apart"


def test_two_recordings_of_one_road_share_what_it_looks_like() -> None:
    """Another road resembles it for 128 m (measured), and both recordings know it."""
    one = Integrity(GatesConfig())
    for meters in range(0, 128, 10):
        both = (drive(one, range(meters, meters + 10), recording=name, uncertainty_m=None) for name in ("one", "two"))
        assert [decision for decisions in both for decision in decisions if decision is None] == []


def test_matches_count_as_evidence_while_gps_is_healthy() -> None:
    """Three kilometers: when GPS fails, the first position is published with a finite level, and not by one stretch."""
    one = Integrity(GatesConfig())
    for driven_m in range(0, 3000, 10):
        fix = msgspec.structs.replace(FIX, lat_deg=driven_m * METRE_DEG)
        position, moved = replace(OWN, lat_deg=driven_m * METRE_DEG), Displacement(1, 0.0, float(driven_m))
        one.observe(fix, replace(MOVING, gps="healthy", position=position, displacement=moved))
        one.contradict_nothing()
    decision = decide(fix, one, position=position, displacement=moved)
    assert decision.refusal is None
    assert decision.level is not None
    assert decision.level.is_within(25.0)


def test_a_false_stretch_is_outvoted_by_two_true_ones_and_not_by_one() -> None:
    one = Integrity(GatesConfig())
    assert None not in drive(one, range(0, 400), off_m=150.0, uncertainty_m=None)
    assert None not in drive(one, range(500, 600), recording="second", uncertainty_m=None)
    assert None in drive(one, range(700, 720), recording="third", uncertainty_m=None)


def test_what_contradicted_the_autopilot_when_it_was_sure_stays_contradicted() -> None:
    """A map that is wrong by 40 m: that the autopilot grows uncertain on the way does not make it right."""
    one = Integrity(GatesConfig())
    for meters in range(100, 1500, 100):
        assert None not in drive(one, range(meters, meters + 100), off_m=40.0, uncertainty_m=3 + meters / 20)


def test_a_bound_by_a_fix_needs_one_stretch_more_than_what_bound_it() -> None:
    one = Integrity(GatesConfig())
    published = decisions(one, range(0, 100))[-1]
    assert published.refusal is None
    one.contradict_nothing()
    bound = {"bound_by_gps": False, "bound_wrong": published.bound_wrong}
    assert None not in drive(one, range(100, 200), off_m=100.0, recording="second", **bound)
    assert None in drive(one, range(300, 400), off_m=100.0, recording="third", **bound), "two against one"


@pytest.mark.parametrize("unknown_m", [0, 60, 90, 150, 300])
def test_evidence_outlives_a_silence_as_far_as_the_vehicle_can_have_gone(unknown_m: float) -> None:
    """As after a reboot without GPS, 40 m further on the same recording; the autopilot is at its origin then."""
    one = Integrity(GatesConfig())
    assert drive(one, range(0, 600), uncertainty_m=None)[-1] is None
    fix = msgspec.structs.replace(FIX, lat_deg=640 * METRE_DEG)
    rebooted = Displacement(2, 0.0, 600.0, unknown_m=unknown_m)
    decision = decide(fix, one, uncertainty_m=None, position=None, displacement=rebooted)
    assert why_not(decision) == (None if 40 < unknown_m < 100 else "not confirmed by another place yet")
    if decision.refusal is None:
        assert decision.level is not None
        assert decision.level.along_m > unknown_m, "the place may be wrong, by as much"


def test_evidence_outlives_first_fixes_after_a_silence_that_are_far_off() -> None:
    """On a recorded drive they were 9 m off (12 m sigma), and right 10 m further on, which was another claim."""
    one = Integrity(GatesConfig())
    assert drive(one, range(0, 600), uncertainty_m=None)[-1] is None
    for driven_m in range(640, 660, 2):
        sigma_m = max(3.0, 12.0 - (driven_m - 640))
        fix = msgspec.structs.replace(FIX, lat_deg=(driven_m + sigma_m - 3.0) * METRE_DEG, sigma_along_m=sigma_m)
        rebooted = Displacement(2, 0.0, driven_m - 40.0, unknown_m=60.0)
        why = reason(fix, one, uncertainty_m=None, position=None, displacement=rebooted)
    assert why is None


@pytest.mark.parametrize("other", [Displacement(2, 0.0, 0.0, unknown_m=2e7), Displacement(1, 0.0, 400.0)])
def test_observations_that_moved_otherwise_confirm_nothing(other: Displacement) -> None:
    """Of another vehicle; and 300 m less than the fixes say."""
    one = Integrity(GatesConfig())
    drive(one, range(0, 100), uncertainty_m=None)
    fix = msgspec.structs.replace(FIX, lat_deg=700 * METRE_DEG, recording="second")
    assert reason(fix, one, uncertainty_m=None, position=None, displacement=other) is not None


def test_the_stated_risk_is_what_decides() -> None:
    far = msgspec.structs.replace(FIX, lat_deg=14 * METRE_DEG)
    assert reason(far, gates=GatesConfig(risk=1e-1)) is None
    assert reason(far, gates=GatesConfig(risk=1e-5)) is not None
    assert reason(far, gates=GatesConfig(risk=1.0), uncertainty_m=None) is None


def test_a_place_that_is_less_certain_may_be_further_from_the_autopilot() -> None:
    far = msgspec.structs.replace(FIX, lat_deg=16 * METRE_DEG)
    assert reason(far) == "not confirmed by another place yet"
    assert reason(msgspec.structs.replace(far, sigma_along_m=10.0)) is None


def test_bayes() -> None:
    assert wrong_probability(0.5, 1e-3) == pytest.approx(0.5)
    assert wrong_probability(1e-3, 0.08) == pytest.approx(1e-6 / (1e-6 + 0.999 * 0.08))


def test_the_autopilots_position_is_moved_back_to_the_exposure() -> None:
    later = replace(OWN, stamp_ns=NOW_NS, lat_deg=10.0 * METRE_DEG, north_mps=10.0)
    assert distance_from(later, FIX) == pytest.approx(0.0, abs=0.1)


def test_uncertainty_grows_with_the_distance_since_it_was_bound() -> None:
    own = OwnPosition(0.05)
    own.bind(3.0, Report(0, driven_m=100.0))
    assert own.sigma_m(Report(0, driven_m=100.0)) == 3.0
    assert own.sigma_m(Report(0, driven_m=180.0)) == pytest.approx(5.0)
    assert own.sigma_m(Report(0, driven_m=180.0), least_m=9.0) == 9.0, "the larger one"
    assert own.sigma_m(Report(0, driven_m=180.0), 0.15, 9.0) == pytest.approx(math.hypot(3.0, 12.0))
    assert own.sigma_m(Report(0)) is None
    own.watch_aid(Report(0, driven_m=190.0, is_aided=False))
    assert own.sigma_m(Report(0, driven_m=190.0)) is None, "it has run away"


def test_a_position_above_the_alert_limit_is_not_published() -> None:
    """One observation, and nothing but places bounds the position; a limit of 0 is none."""
    why = "its protection level is above the alert limit"
    assert reason(gates=GatesConfig(alert_limit_m=40.0)) == why
    assert reason() is None


def test_the_alert_limit_lets_pass_what_reckoning_bounds_below_it() -> None:
    reckoned = Reckoned(2.0, 3.0, 3.0)
    assert reason(gates=GatesConfig(alert_limit_m=40.0), reckoned=reckoned, speed_mps=5.0) is None
    assert reason(gates=GatesConfig(alert_limit_m=15.0), reckoned=reckoned, speed_mps=5.0) is not None


def test_stretches_that_agree_make_a_level_of_the_errors_alone() -> None:
    one = Integrity(GatesConfig(alert_limit_m=40.0))
    assert set(drive(one, range(0, 500))) == {"its protection level is above the alert limit"}
    newest = decisions(one, range(500, 1200))[-1]
    level = newest.level
    assert newest.refusal is None
    assert level is not None
    shift_m = UNNOTICED.most_m
    assert level.along_m - shift_m == pytest.approx(1.5 * (level.across_m - shift_m))


@pytest.mark.parametrize("ends_m", range(2160, 2650, 60))
def test_a_level_holds_wherever_a_shifted_stretch_begins(ends_m: int) -> None:
    """15 m after a gap of 140 m, which may be the odometer's error, over 500 m of one recording."""
    one, precise = Integrity(GatesConfig()), msgspec.structs.replace(FIX, sigma_along_m=1.0, sigma_across_m=1.0)
    drive(one, range(0, 2000), fix=precise)
    level = decisions(one, range(2140, ends_m), off_m=15.0, fix=precise, uncertainty_m=30.0)[-1].level
    assert level is not None
    assert level.along_m > 15.0


def test_what_is_not_published_has_no_protection_level() -> None:
    assert decide().level is not None
    assert decide(gps="healthy").level is None


def test_asking_changes_nothing_that_was_observed() -> None:
    """After a halt, a position from before it lies far from where the newest velocity puts the autopilot then."""
    one = Integrity(GatesConfig())
    assert reason(one=one) is None
    long_after = replace(MOVING, now_ns=NOW_NS + 45 * S, position=replace(OWN, stamp_ns=NOW_NS + 45 * S, north_mps=9.0))
    refusal = one.decide(FIX, long_after, Limits(1.0, 5.0)).refusal
    assert refusal is not None
    assert refusal.reason == "too old"
    assert refusal.distance_m == pytest.approx(9.0 * 46, abs=1)
    assert reason(one=one) is None


def test_the_rules_are_checked_in_the_order_of_the_page_and_each_has_its_test() -> None:
    rules = Integrity(GatesConfig()).rules(FIX, MOVING, Limits(1.0, 5.0), Claim(), 1.0, ProtectionLevel(1.0, 1.0))
    assert tuple(reason for reason, _ in rules) == tuple(rule.reason for rule in RULES)
    assert {rule.reason for rule in RULES} == set(get_args(Reason))
    tests = "".join(path.read_text() for path in Path(__file__).parents[1].glob("*/test_*.py"))
    assert [rule.test for rule in RULES if f"def {rule.test}(" not in tests] == []
    page = (Path(__file__).parents[2] / "docs/positions.md").read_text(encoding="utf-8")
    assert as_table() in page, "write it anew: python -m tests.docs.refusals_table"
