"""A drive before it is driven: the way, the vehicle, and where GPS fails."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import msgspec
import numpy as np

from sim.trial.driver import Leg
from sim.trial.way import Way
from sim.vehicle.estimator import OdometryErrors
from sim.vehicle.gps import GpsReport
from sim.world.scenario import Scenario


@dataclass
class Draft:
    """One seeded drive. Seconds count from the start of the drive, meters along its way.

    home: the road as seen tonight. gps_until_m: where GPS fails, whatever gps_at says. lon_shift_deg: by which the
    simulation's origin is moved east. keypoints: the map has them, and pictures are rendered.
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
    lon_shift_deg: float = 0.0
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
