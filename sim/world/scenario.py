"""A scenario: one TOML file that names a world, a drive through it, and the camera.

    seed = 1                 # the world: route and all that stands along it
    length_m = 1200.0        # of the route, 200 to 20000
    repeats_m = 0.0          # a straight street whose houses repeat after so many meters, 0 is none; 10 to 200
    direction = "forward"    # or "reverse": the way home
    lane_m = 1.75            # left of the road's middle as the driver sees it, -3 to 3
    speed_mps = 10.0         # about which the speed varies, 1 to 40
    stops = 0                # halts on the way, 0 to 50
    drive_seed = 1           # speed profile, other cars, lit windows, sensor noise
    light = "day"            # day, dusk, night, rain or snow
    view = "front"           # or "rear"
    width = 320              # picture, pixels
    height = 240
    fov_deg = 80.0           # horizontal, 30 to 120
    camera_ahead_m = 0.0     # of the vehicle's GPS antenna, which positions are of; -10 to 10
    camera_down_deg = 0.0    # by which the camera looks down, -30 to 30
    camera_right_deg = 0.0   # by which it is turned clockwise, seen from above, -30 to 30
    shaking = 0.0            # pitch and roll of the vehicle, 1 as a car's, 0 to 3
    exposure_s = 0.0         # of a picture, which blurs what moves, 0 to 0.1
    readout_s = 0.0          # from the first row to the last (rolling shutter), 0 to 0.1
    car_ahead_m = 0.0        # a car that drives so far ahead; 0 is none
    epoch_ns = 0             # CLOCK_MONOTONIC at the start; without it, the time at which the camera opens

In processes that share a scenario with `epoch_ns`, the vehicle is at the same place at the same time.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from msgspec import Meta, Struct

from edge.toml_file import read_toml
from sim.world.drive import WorldDrive, plan_drive
from sim.world.route import generate_route

Seed = Annotated[int, Meta(ge=0, le=2**32 - 1)]
View = Literal["front", "rear"]
LightName = Literal["day", "dusk", "night", "rain", "snow"]


class Scenario(Struct, frozen=True, forbid_unknown_fields=True):
    """A scenario; every key has a default."""

    seed: Seed = 1
    length_m: Annotated[float, Meta(ge=200, le=20000)] = 1200.0
    repeats_m: Annotated[float, Meta(ge=10, le=200)] | Literal[0] = 0
    direction: Literal["forward", "reverse"] = "forward"
    lane_m: Annotated[float, Meta(ge=-3, le=3)] = 1.75
    speed_mps: Annotated[float, Meta(ge=1, le=40)] = 10.0
    stops: Annotated[int, Meta(ge=0, le=50)] = 0
    drive_seed: Seed = 1
    light: LightName = "day"
    view: View = "front"
    width: Annotated[int, Meta(ge=32, le=2048)] = 320
    height: Annotated[int, Meta(ge=24, le=2048)] = 240
    fov_deg: Annotated[float, Meta(ge=30, le=120)] = 80.0
    camera_ahead_m: Annotated[float, Meta(ge=-10, le=10)] = 0.0
    camera_down_deg: Annotated[float, Meta(ge=-30, le=30)] = 0.0
    camera_right_deg: Annotated[float, Meta(ge=-30, le=30)] = 0.0
    shaking: Annotated[float, Meta(ge=0, le=3)] = 0.0
    exposure_s: Annotated[float, Meta(ge=0, le=0.1)] = 0.0
    readout_s: Annotated[float, Meta(ge=0, le=0.1)] = 0.0
    car_ahead_m: Annotated[float, Meta(ge=0, le=100)] = 0.0
    epoch_ns: Annotated[int, Meta(ge=0)] | None = None

    def drive(self) -> WorldDrive:
        """The motion that this scenario describes."""
        route = generate_route(self.seed, self.length_m, self.repeats_m)
        motion = {"lane_m": self.lane_m, "speed_mps": self.speed_mps, "shaking": self.shaking}
        return plan_drive(route, self.direction, seed=self.drive_seed, stops=self.stops, **motion)


def load_scenario(path: Path) -> Scenario:
    """Read and check a scenario file; ConfigError names the file and the key, in one line."""
    return read_toml(path, Scenario)
