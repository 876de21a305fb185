"""B and L: vehicles that leave the road, turn, reverse, stand, and are carried."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from sim.research.trial import course_rules as rule
from sim.research.trial.course import CourseDraft, MapStretch, course
from sim.research.trial.ways import bent, beside, carried_on, carried_to, joined, towed
from sim.trial.way import Leg, Way, along

APART_M = 12.0
STANDS_S = 10.0
FOLLOWED_M, CARRIED_M = 150.0, 100.0
OFF_S, OFF_FOR_S, SET_DOWN_S = 40.0, 30.0, 30.0
"""A vehicle that stops after FOLLOWED_M, within 33 s, is switched off later, carried while it is off, and set down for
as long as it stood before."""


@course("B", "turn-off")
def _turn_off(draft: CourseDraft) -> None:
    """By 90 degrees into a road that is not on the map, in the middle of one that is."""
    middle_m = draft.share(0.5)
    away = along(draft.road(seed=draft.world + 100), draft.length_m, draft.share(0.6))
    way = along(draft.home, draft.length_m, middle_m).turned(draft.rng.choice((-90.0, 90.0)))
    draft.unsent = [(way.length_m, math.inf)]
    draft.drive(joined(way, away))


@course("B", "u-turn")
def _u_turn(draft: CourseDraft) -> None:
    """Back the way it came, on the other lane."""
    way, turned, back = _there_and_back(draft, draft.share(0.5))
    draft.drive(back, Leg(way.length_m), Leg(turned.length_m + 5, 2.0), Leg(back.length_m - 2))


@course("B", "dead-end")
def _dead_end(draft: CourseDraft) -> None:
    """Into a dead end, a few meters back, round, and out again on the other lane."""
    way, turned, out = _there_and_back(draft, draft.share(0.4))
    back = Leg(way.length_m - 12, -2.0)
    draft.drive(out, Leg(way.length_m), back, Leg(turned.length_m + 5, 2.0), Leg(out.length_m - 2))


def _there_and_back(draft: CourseDraft, at_m: float) -> tuple[Way, Way, Way]:
    """The way to a point of the road, the same and round it, and the same and back on the other lane."""
    way = along(draft.home, draft.length_m, at_m)
    turned = way.turned(180.0, radius_m=draft.home.lane_m)
    return way, turned, turned.then(along(draft.road(direction="forward"), at_m + 1, draft.length_m))


@course("B", "figure-eight", rules=(*rule.USUAL, rule.sends))
def _figure_eight(draft: CourseDraft) -> None:
    """A loop to the right and one to the left, and the first once more."""
    middle_m = draft.share(0.5)
    right = bent(along(draft.home, draft.length_m - 2, middle_m))
    left = bent(along(draft.home, middle_m - 1, 0.0), to_the_left=True)
    draft.drive(joined(right, left).then(right))
    draft.map = [MapStretch(0.0, draft.length_m, on_way=True)]


@course("B", "circle-twice", rules=(*rule.USUAL, rule.sends))
def _circle_twice(draft: CourseDraft) -> None:
    """The same circle twice."""
    lap = bent(along(draft.home, draft.length_m - 2, draft.share(0.4)))
    draft.drive(lap.then(lap))
    draft.map = [MapStretch(0.0, draft.length_m, on_way=True)]


@course("B", "laps-12-apart", rules=(*rule.USUAL, rule.sends))
def _laps_apart(draft: CourseDraft) -> None:
    """A circle, and then another one 12 m outside; both are mapped."""
    lap = bent(along(draft.home, draft.length_m - 2, draft.share(0.4)))
    outwards_m = 30.0
    both = beside(lap.then(lap), lambda m: APART_M * min(max((m - lap.length_m) / outwards_m, 0.0), 1.0))
    draft.drive(both)
    inside = MapStretch(draft.share(0.4), draft.length_m, on_way=True)
    draft.map = [inside, replace(inside, left_m=-APART_M)]


@course("B", "lane-12-beside")
def _lane_beside(draft: CourseDraft) -> None:
    """12 m beside the lane on which the map was made, to the left or to the right."""
    left_m = float(draft.rng.choice((-APART_M, APART_M)))
    draft.drive(beside(draft.way, lambda m: left_m))


@course("B", "parallel-streets-12", rules=(*rule.USUAL, rule.sends))
def _parallel_12(draft: CourseDraft) -> None:
    """Another street 12 m to the left or to the right, both mapped, and seen from both."""
    draft.map = [draft.map[0], replace(draft.map[0], left_m=float(draft.rng.choice((-APART_M, APART_M))))]


@course("B", "parallel-streets-30", rules=(*rule.USUAL, rule.sends))
def _parallel_30(draft: CourseDraft) -> None:
    """Another street 30 m to the left or to the right, both mapped, which looks different."""
    other = replace(draft.map[0], left_m=float(draft.rng.choice((-30.0, 30.0))), appearance=draft.world + 100)
    draft.map = [draft.map[0], other]


@course("B", "reversing-{}", 2, 4)
def _reversing(draft: CourseDraft, value: float) -> None:
    """60 m backwards in the middle of the drive."""
    middle_m = draft.share(0.5)
    draft.drive(draft.way, Leg(middle_m), Leg(middle_m - 60, -value), Leg(draft.way.length_m - 2))


@course("B", "stop", rules=(*rule.USUAL, rule.resumes))
def _stop(draft: CourseDraft) -> None:
    """45 s at rest, and on."""
    draft.drive(draft.way, Leg(draft.share(0.6), then_wait_s=45.0), Leg(draft.way.length_m - 2))


@course("B", "ferry")
def _ferry(draft: CourseDraft) -> None:
    """Carried for 2 km, then on over another road; a person drives, since the autopilot is lost by design."""
    draft.steers = False
    there = carried_on(along(draft.home, draft.length_m, draft.share(0.6)), 2000)
    draft.unsent = [(there.length_m - 2000, math.inf)]
    draft.drive(joined(there, along(draft.road(seed=draft.world + 100), draft.length_m, draft.share(0.5))))


@course("B", "tow")
def _tow(draft: CourseDraft) -> None:
    """100 m along the mapped road with the wheels in the air."""
    draft.steers = False
    draft.drive(towed(draft.way, int(draft.share(0.5)), int(draft.share(0.5) + 100)))


@course("L", "standing-start", rules=(*rule.HONEST, rule.never_wrong, rule.known_at_rest))
def _standing_start(draft: CourseDraft) -> None:
    """Switched on at rest anywhere on the map of repeat-dusk, without GPS, and with an origin 260 m off; then on."""
    draft.origin_off_m = draft.side(260.0)
    draft.home = draft.road(light="dusk", direction="forward")
    draft.map = [MapStretch(0.0, draft.length_m, left_m=-0.5, camera=("front", "day", 1))]
    way = along(draft.home, draft.rng.uniform(0.0, 0.6) * draft.length_m, draft.length_m)
    draft.drive(way, Leg(0.0, then_wait_s=STANDS_S), Leg(way.length_m - 2))
    draft.has_gps = draft.steers = False


@course("L", "kidnapped{}", "", "-off", rules=(*rule.HONEST, rule.never_wrong, rule.known_again))
def _kidnapped(draft: CourseDraft, value: str) -> None:
    """Home at dusk; carried 100 m ahead on the map at rest, also while it is switched off; a person drives on."""
    draft.home = draft.road(light="dusk")
    followed_m = draft.length_m - FOLLOWED_M
    there = along(draft.home, draft.length_m, followed_m)
    way = carried_to(there, along(draft.home, followed_m - CARRIED_M, 0.0))
    wait_s, carried = SET_DOWN_S if value else STANDS_S, np.flatnonzero(way.carried)
    picked_up, set_down = (Leg(float(row), then_wait_s=wait_s) for row in (carried[0], carried[-1] + 1))
    draft.drive(way, picked_up, set_down, Leg(way.length_m - 2))
    draft.steers = False
    if value:
        draft.killed_s, draft.down_s, draft.restarted_s = OFF_S, OFF_FOR_S, OFF_S + 1.0
        draft.origin_off_m = (0.0, 0.0)
