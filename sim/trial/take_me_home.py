"""The main task, and the whole of what Lookback is for: out by day with a map made on the way, and home without GPS."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim.trial.draft import Draft
from sim.trial.driver import Leg
from sim.trial.way import Way, along

SET_OFF_M = 40.0
"""From the start of the road: a vehicle that comes home may drive on too far."""


def home_at_night(seed: int, length_m: float, world: int) -> Draft:
    """Out by day; GPS is lost at the turn; home at night."""
    draft = Draft(np.random.default_rng([seed, 7]), length_m, world)
    out_and_home(draft, "night")
    return draft


def out_and_home(draft: Draft, light: str) -> None:
    """Out by day; GPS is lost at the turn; home in this light."""
    draft.home = draft.road(light=light)
    out = along(draft.road(light="day", direction="forward", drive_seed=1), SET_OFF_M, draft.length_m)
    home_by(draft, out)


def home_by(draft: Draft, out: Way, legs: Sequence[Leg] = ()) -> None:
    """Out by a way, in these legs and to its end; GPS is lost at the turn; home along the road."""
    turned = out.turned(180.0, radius_m=draft.home.lane_m)
    way = turned.then(along(draft.home, draft.length_m, 0.0))
    draft.drive(way, *legs, Leg(out.length_m), Leg(turned.length_m + 5, 2.0), Leg(way.length_m - SET_OFF_M))
    draft.gps_until_m = out.length_m
