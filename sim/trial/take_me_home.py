"""The main task, and the whole of what Lookback is for: out by day with a map made on the way, and home without GPS."""

from __future__ import annotations

from functools import partial

from sim.trial.draft import Course, Draft, Stretch
from sim.trial.rules import arrives, no_false_place, not_worse, on_its_lane, resumes, within_sigmas
from sim.trial.way import along
from sim.vehicle.driver import Leg
from sim.vehicle.gps import GpsReport

SET_OFF_M = 40.0
"""From the start of the road: a vehicle that comes home may drive on too far."""


def home_in(draft: Draft, value: str) -> None:
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


AT_NIGHT = Course("G", partial(home_in, value="night"), " ".join((home_in.__doc__ or "").split()))
