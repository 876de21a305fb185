"""What differs between drives: parked cars, oncoming cars, and which windows are lit."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sim.world.cars import draw_car
from sim.world.drive import WorldDrive
from sim.world.route import DistrictKind, WorldRoute
from sim.world.solids import Plot, Thing

PARKED_SHARE: dict[DistrictKind, float] = {"town": 0.45, "shops": 0.4, "suburb": 0.25, "wood": 0.02, "open": 0.02}
PARKED_LEFT_M = 4.7
ONCOMING_EVERY_S = 9.0


@dataclass(frozen=True)
class MovingCar:
    """A car that comes toward the drive, at a steady speed; its shape is at the origin, facing north."""

    things: tuple[Thing, ...]
    drive: WorldDrive
    start_m: float
    speed_mps: float

    def position(self, time_s: float) -> tuple[float, float, float]:
        """East, north (m) and heading (rad) at a time of the drive; it may be off the road's ends."""
        sign = 1.0 if self.drive.direction == "forward" else -1.0
        ahead_m = self.start_m - self.speed_mps * time_s
        route_m = ahead_m if sign > 0 else self.drive.route.length_m - ahead_m
        east, north, heading = self.drive.route.at(route_m, -sign * max(1.6, abs(self.drive.lane_m)))
        return east, north, heading + (np.pi if sign > 0 else 0.0)

    def on_road(self, time_s: float) -> bool:
        """Whether it is on the modeled road at all."""
        ahead_m = self.start_m - self.speed_mps * time_s
        return bool(-60 < ahead_m < self.drive.route.length_m + 60)


@dataclass(frozen=True)
class CarAhead:
    """A car in the lane of the drive, always as far ahead; its shape as that of a `MovingCar`."""

    things: tuple[Thing, ...]
    drive: WorldDrive
    ahead_m: float

    def position(self, time_s: float) -> tuple[float, float, float]:
        """East, north (m) and heading (rad) at a time of the drive."""
        pose = self.drive.pose(time_s, self.ahead_m)
        return pose.east_m, pose.north_m, float(np.radians(pose.heading_deg))

    def on_road(self, time_s: float) -> bool:
        """It always is."""
        return True


@dataclass(frozen=True)
class Traffic:
    """The cars of one drive; `window_seed` decides which windows are lit."""

    parked: tuple[Thing, ...]
    moving: tuple[MovingCar, ...]
    window_seed: int
    ahead: CarAhead | None = None


def build_traffic(drive: WorldDrive, car_ahead_m: float = 0.0) -> Traffic:
    """The traffic of a drive; its seed decides. car_ahead_m: of a car that drives ahead, 0 for none."""
    rng = np.random.default_rng([drive.seed, 4])
    parked: list[Thing] = []
    for side in (1, -1):
        for route_m in np.arange(-60.0, drive.route.length_m + 60, 6.5):
            if rng.random() < PARKED_SHARE[drive.route.district(float(route_m))]:
                car = draw_car(_curb(drive.route, float(route_m), side, rng), rng)
                parked += [replace(thing, windows=()) for thing in car]  # its lamps are off
    moving, window_seed = _oncoming(drive, rng), int(rng.integers(2**31))
    ahead = CarAhead(draw_car(Plot((0.0, 0.0), (1.0, 0.0), (0.0, 1.0)), rng), drive, car_ahead_m)
    return Traffic(tuple(parked), moving, window_seed, ahead if car_ahead_m else None)


def _curb(route: WorldRoute, route_m: float, side: int, rng: np.random.Generator) -> Plot:
    """Where a parked car stands: it faces the way that its side of the road drives, mostly."""
    east, north, heading = route.at(route_m, side * (PARKED_LEFT_M + rng.uniform(-0.1, 0.3)))
    if (side < 0) != (rng.random() < 0.15):
        heading += np.pi
    forward = (float(np.sin(heading)), float(np.cos(heading)))
    return Plot((east, north), (forward[1], -forward[0]), forward)


def _oncoming(drive: WorldDrive, rng: np.random.Generator) -> tuple[MovingCar, ...]:
    """Cars from the far end, one each ONCOMING_EVERY_S or so, that meet the vehicle somewhere on its way."""
    plot = Plot((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))
    cars = []
    for meet_s in np.arange(rng.uniform(2, 8), drive.duration_s, ONCOMING_EVERY_S):
        speed = rng.uniform(8, 14)
        time_s = float(meet_s + rng.uniform(-3, 3))
        cars.append(MovingCar(draw_car(plot, rng), drive, drive.distance_m(time_s) + speed * time_s, speed))
    return tuple(cars)
