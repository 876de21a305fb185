"""G: the main task, and the whole of what Lookback is for: the autopilot steers itself home by its own estimate."""

from __future__ import annotations

from sim.trial.courses.registry import course
from sim.trial.draft import Draft, Stretch
from sim.trial.rules import (
    arrives,
    close,
    no_false_place,
    not_worse,
    on_its_lane,
    resumes,
    sends,
    within_sigmas,
)
from sim.trial.way import along
from sim.vehicle.driver import Leg
from sim.vehicle.gps import GpsReport

HOME_LIGHTS = ("day", "dusk", "night", "rain")
SET_OFF_M = 40.0
"""From the start of the road: a vehicle that comes home may drive on too far."""


@course("G", "home")
def _home(draft: Draft) -> None:
    """The main task: the autopilot drives home at night without GPS, over a road that is mapped whole."""
    draft.rules = (within_sigmas, no_false_place, not_worse, close, sends, resumes)


@course("G", "take-me-home")
def _take_me_home(draft: Draft) -> None:
    """Out by day, mapped by a rear camera; GPS is lost at the turn; home on that map, in one of four lights."""
    _home_in(draft, str(draft.rng.choice(HOME_LIGHTS)))


@course("G", "take-me-home-{}", *HOME_LIGHTS)
def _home_in(draft: Draft, value: str) -> None:
    """Out by day, mapped by a rear camera; GPS is lost at the turn; home on that map, in this light."""
    draft.home = draft.road(light=value)
    out = along(draft.road(light="day", direction="forward", drive_seed=1), SET_OFF_M, draft.length_m)
    turned = out.turned(180.0, radius_m=draft.home.lane_m)
    way = turned.then(along(draft.home, draft.length_m, 0.0))
    home_m = way.length_m - SET_OFF_M
    draft.drive(way, Leg(out.length_m), Leg(turned.length_m + 5, 2.0), Leg(home_m))
    draft.maps_live = True
    draft.map = [Stretch(SET_OFF_M, draft.length_m)]
    draft.gps_at, draft.gps_until_m = lambda time_s: GpsReport(), out.length_m
    draft.rules = (within_sigmas, no_false_place, not_worse, arrives, on_its_lane, resumes)


@course("G", "person")
def _person(draft: Draft) -> None:
    """A person keeps to the lane, whatever the autopilot believes."""
    draft.steers = False
    draft.rules = (within_sigmas, no_false_place, not_worse, sends, resumes)
