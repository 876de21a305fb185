"""B: vehicles that leave the road, turn, reverse, stand, and are carried."""

from __future__ import annotations

import math

from sim.trial.courses.registry import course
from sim.trial.draft import Draft
from sim.trial.rules import (
    no_false_place,
    not_worse,
    resumes,
    within_sigmas,
)
from sim.trial.way import along
from sim.vehicle.driver import Leg


@course("B", "turn-off")
def _turn_off(draft: Draft) -> None:
    """By 90 degrees into a road that is not on the map, in the middle of one that is."""
    middle_m = draft.share(0.5)
    away = along(draft.road(seed=draft.world + 100), draft.length_m, draft.share(0.6))
    way = along(draft.home, draft.length_m, middle_m).turned(draft.rng.choice((-90.0, 90.0)))
    draft.unsent = [(way.length_m, math.inf)]
    draft.drive(way.then(away, moved=True))


@course("B", "u-turn")
def _u_turn(draft: Draft) -> None:
    """Back the way it came, on the other lane."""
    middle_m = draft.share(0.5)
    way = along(draft.home, draft.length_m, middle_m)
    turned = way.turned(180.0, radius_m=draft.home.lane_m)
    back = turned.then(along(draft.road(direction="forward"), middle_m + 1, draft.length_m))
    draft.drive(back, Leg(way.length_m), Leg(turned.length_m + 5, 2.0), Leg(back.length_m - 2))


@course("B", "reversing-{}", 2, 4)
def _reversing(draft: Draft, value: float) -> None:
    """60 m backwards in the middle of the drive."""
    middle_m = draft.share(0.5)
    draft.drive(draft.way, Leg(middle_m), Leg(middle_m - 60, -value), Leg(draft.way.length_m - 2))


@course("B", "stop")
def _stop(draft: Draft) -> None:
    """45 s at rest, and on."""
    draft.drive(draft.way, Leg(draft.share(0.6), then_wait_s=45.0), Leg(draft.way.length_m - 2))
    draft.rules = (within_sigmas, no_false_place, not_worse, resumes)


@course("B", "ferry")
def _ferry(draft: Draft) -> None:
    """Carried for 2 km, then on over another road; a person drives, since the autopilot is lost by design."""
    draft.steers = False
    there = along(draft.home, draft.length_m, draft.share(0.6)).carried_on(2000)
    draft.unsent = [(there.length_m - 2000, math.inf)]
    draft.drive(there.then(along(draft.road(seed=draft.world + 100), draft.length_m, draft.share(0.5)), moved=True))


@course("B", "tow")
def _tow(draft: Draft) -> None:
    """100 m along the mapped road with the wheels in the air."""
    draft.steers = False
    draft.drive(draft.way.towed(int(draft.share(0.5)), int(draft.share(0.5) + 100)))
