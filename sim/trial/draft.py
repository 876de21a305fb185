"""A drive before it is driven: the way, the vehicle, and where GPS fails.

The main task, and the whole of what Lookback is for: out by day with a map made on the way, and home without GPS.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import msgspec
import numpy as np

from sim.trial.way import Leg, Way, along
from sim.vehicle.estimator import OdometryErrors
from sim.vehicle.gps import GpsReport
from sim.world.scenario import Scenario


@dataclass
class Draft:
    """One seeded drive. Seconds count from the start of the drive, meters along its way.

    home: the road as seen tonight. gps_until_m: where GPS fails, whatever gps_at says. keypoints: the map has them, and
    pictures are rendered.
    """

    rng: np.random.Generator
    length_m: float
    world: int
    home: Scenario = field(init=False)
    way: Way = field(init=False)
    legs: list[Leg] = field(init=False)
    errors: OdometryErrors = field(init=False)
    gps_at: Callable[[float], GpsReport] = lambda time_s: GpsReport()
    gps_until_m: float = math.inf
    keypoints: bool = False

    def __post_init__(self) -> None:
        self.home = Scenario(seed=self.world, length_m=self.length_m, light="night", direction="reverse", drive_seed=2)
        sign = self.rng.choice((-1.0, 1.0))
        self.errors = OdometryErrors(
            scale=1.0 + 0.03 * self.rng.choice((-1.0, 1.0)),
            heading_deg=self.rng.uniform(0.1, 0.5) * sign,
            gyro_dps=self.rng.uniform(0.02, 0.12) * sign,
        )

    def drive(self, way: Way, *legs: Leg) -> None:
        """Drive this way, in these legs or in one."""
        self.way = way
        self.legs = list(legs) or [Leg(way.length_m - 2)]

    def road(self, **changes: float | str) -> Scenario:
        """The road as seen tonight, with changes: another `seed`, the other `direction`."""
        return msgspec.structs.replace(self.home, **changes)


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
