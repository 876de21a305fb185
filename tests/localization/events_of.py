"""The stand-in vehicle of the tests: the events of a drive, and what the position estimator answers.

`Vehicle` drives due north along a mapped road, and sees exactly what it should. A test says what else happens: what the
autopilot reports (`reports`), what the frames show, how the vehicle moves. Then it asks for a position. All are meters
north of HOME. `route_bench` drives winding roads, with the errors that were measured.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal, TypeAlias

import msgspec
import numpy as np

from edge.config import Config, GatesConfig, RigConfig, SequenceConfig, TrackingConfig
from edge.geodesy import VehiclePosition, east_north_of, moved
from edge.localization import (
    GPS_SIGMA_M,
    AutopilotState,
    Fix,
    FixFeedback,
    FixRequest,
    GpsFix,
    GpsVerdict,
    MapUpdate,
    NoFix,
    Odometry,
    OdometryUpdate,
    PlaceFix,
    PositionEstimator,
)
from edge.localization.dead_reckoning import GyroReading, Gyros
from edge.localization.events import ImageProcessed
from edge.localization.position_estimator import Listener
from edge.reference_map import MapSet
from edge.sequence import PlaceMatch
from tests.common import S
from tests.localization.route_course import HOME, SPACING_M, Stretch, build_maps

LENGTH, FRAME_NS, SPEED_MPS = 20, S // 5, 10.0
LINE_M = LENGTH * SPACING_M
Direction: TypeAlias = Literal["forward", "reverse"]
Sees: TypeAlias = Callable[[float], PlaceMatch | None]
"""What a frame shows at so many meters."""


def settings(rig: RigConfig = RigConfig(), gates: GatesConfig = GatesConfig(), **tracking: Any) -> Config:  # noqa: B008
    return Config(rig=rig, gates=gates, tracking=TrackingConfig(**tracking), sequence=SequenceConfig(length=LENGTH))


class Road:
    """A straight road to the north, and the map of some stretches of it."""

    def __init__(self, folder: Path, *stretches: Stretch) -> None:
        line = np.zeros((round(stretches[-1].ends_m) + 1, 2))
        line[:, 1] = np.arange(len(line))
        self.maps, self._segments = build_maps(folder / "map", line, np.zeros(len(line)), stretches)

    def match(
        self, at_m: float, direction: Direction = "forward", part: int | None = None, **changes: Any
    ) -> PlaceMatch | None:
        """The place at so many meters, of one of the stretches; None where there is none."""
        for number, (first, begins_m, ends_m, _) in enumerate(self._segments):
            if part in (None, number) and begins_m <= at_m <= ends_m:
                return match(first + round((at_m - begins_m) / SPACING_M), direction, **changes)
        return None


def match(place: int, direction: Direction = "forward", **changes: Any) -> PlaceMatch:
    fields: dict[str, Any] = {
        "place_index": place,
        "place": place,
        "direction": direction,
        "order": "same",
        "slope": 1.0,
        "distance": 0.5,
        "uniqueness": 1.2,
        "sharpness": 0.2,
        "accepted": True,
        "confidence": 0.999,
    }
    return PlaceMatch(**{**fields, **changes})


def nothing(at_m: float) -> None:
    """What a frame shows off the map."""


def gps_at(north_m: float, east_m: float = 0.0, sigma_m: float = GPS_SIGMA_M) -> GpsFix:
    return GpsFix(*moved(*HOME, east_m, north_m), sigma_m)


class StandIn:
    """What the daemon tells the position estimator of a vehicle, and asks it.

    motion, without_gps: its odometry, and that by gyros. frame: what else is known of each, see `ImageProcessed`.
    """

    def __init__(self, maps: MapSet, config: Config, *listeners: Listener) -> None:
        self.config = config
        self.drive = PositionEstimator(config, *listeners)
        self.drive.update(0, MapUpdate(maps))
        self.t_ns = 100 * S
        self.motion: Odometry | None = Odometry(1, 0.0, 0.0)
        self.frame: dict[str, Any] = {}

    @property
    def without_gps(self) -> GyroReading | None:
        """Its own motion."""
        return None if self.motion is None else GyroReading(self.motion.odometry_epoch)

    def report(self, *, has_gps: bool = False, **reports: Any) -> None:
        """The autopilot reports something."""
        own = AutopilotState(
            gps="healthy" if has_gps else "not healthy",
            gps_sigma_m=GPS_SIGMA_M if has_gps else None,
            motion=self.motion,
        )
        self.drive.update(self.t_ns, msgspec.structs.replace(own, **reports))

    def exposed(self, seen: PlaceMatch | None, gps: GpsFix | None = None) -> ImageProcessed:
        """A frame, with what it shows and what is known of GPS at its exposure."""
        known = {"motion": self.motion, "without_gps": self.without_gps, "gps": gps}
        return ImageProcessed(self.t_ns, seen, **{**known, **self.frame})

    def ask(self, later_ns: int = 0, **limits: Any) -> Fix | NoFix:
        return self.drive.fix(self.t_ns + later_ns, FixRequest(**{"oldest_s": 5.0, **limits}))

    def use(self, fix: Fix) -> None:
        """The autopilot gets a position."""
        self.drive.update(self.t_ns, FixFeedback(fix))


class Vehicle(StandIn):
    """One frame each 2 m, a fifth of a second apart.

    north_m: where it is. odometer: meters that it measures for each. aside_m: to the east, in each frame. off_m: how
    far the autopilot has it too far north. compass_rad: its heading less that by the gyros. nose_deg: its heading less
    its course. reports: what else the autopilot says, see `AutopilotState`.
    """

    motion: Odometry

    def __init__(
        self,
        road: Road,
        config: Config | None = None,
        north_m: float = 0.0,
        direction: Direction = "forward",
        listeners: Sequence[Listener] = (),
    ) -> None:
        super().__init__(road.maps, config or settings(), *listeners)
        self.reports: dict[str, Any] = {}
        self.road, self.direction = road, direction
        self.sign = 1 if direction == "forward" else -1
        self.north_m, self.driven_m = north_m, 0.0
        self.odometer, self.sideways_m, self.off_m, self.compass_rad, self.nose_deg = 1.0, 0.0, 0.0, 0.0, 0.0

    def copy(self) -> Vehicle:
        """The same vehicle, for another way to go on; road and map are shared."""
        return copy.deepcopy(self, {id(one): one for one in (self.road, self.road.maps)})

    def go(self, meters: float, sees: Sees | None = None, *, gps: bool = False) -> list[str | None]:
        """Drive on; why there is no position for ArduPilot after each frame, None where there is one."""
        return [one.reason if isinstance(one, NoFix) else None for one in self.answers(meters, sees, gps=gps)]

    def answers(self, meters: float, sees: Sees | None = None, *, gps: bool = False) -> list[Fix | NoFix]:
        """The same, with the positions."""
        return [self._step(sees, gps=gps) for _ in range(round(meters / SPACING_M))]

    def _step(self, sees: Sees | None, *, gps: bool) -> Fix | NoFix:
        self.move()
        self.own(has_gps=gps)
        shown = sees(self.north_m) if sees else self.road.match(self.north_m, self.direction)
        self.show(shown, gps_at(self.north_m + self.off_m) if gps else None)
        return self.ask()

    def move(self) -> None:
        """To the next place."""
        self.t_ns += FRAME_NS
        self.north_m += self.sign * SPACING_M
        self.driven_m += self.odometer * SPACING_M
        self.motion = self.moved(self.odometer * SPACING_M, self.sideways_m)

    def show(self, seen: PlaceMatch | None, gps: GpsFix | None = None) -> GpsVerdict:
        """What a frame shows here; what is known of GPS then."""
        self.drive.update(self.t_ns, self.exposed(seen, gps))
        return self.drive.state.gps

    @property
    def without_gps(self) -> GyroReading:
        """Its own motion, by gyros."""
        return GyroReading(self.motion.odometry_epoch, Gyros(self.compass_rad))

    @property
    def position(self) -> VehiclePosition:
        """Where the autopilot has it."""
        at = moved(*HOME, 0.0, self.north_m + self.off_m)
        course_deg = math.degrees(math.atan2(self.sideways_m, self.sign * SPACING_M))
        return VehiclePosition(
            self.t_ns, *at, 0.0, (course_deg + self.nose_deg) % 360, SPEED_MPS, self.sign * SPEED_MPS
        )

    def own(self, *, has_gps: bool = False, **reports: Any) -> None:
        """The autopilot reports something."""
        known = {"position": self.position, "speed_mps": SPEED_MPS, "driven_m": self.driven_m, **self.reports}
        self.report(has_gps=has_gps, **{**known, **reports})

    def moved(self, ahead_m: float = 0.0, east_m: float = 0.0, **changes: Any) -> Odometry:
        """The displacement once it has moved on by so much."""
        now = self.motion
        return msgspec.structs.replace(
            now, north_m=now.north_m + self.sign * ahead_m, east_m=now.east_m + east_m, **changes
        )

    def unheard(self, meters: float, unknown_m: float) -> None:
        """The vehicle moves on while its velocity is unknown, by at most so much."""
        self.north_m += self.sign * meters
        self.t_ns += S
        self.motion = self.moved(
            odometry_epoch=self.motion.odometry_epoch + 1, unknown_m=self.motion.unknown_m + unknown_m
        )

    @property
    def place(self) -> PlaceFix | None:
        """The position at the newest exposure, whether or not it may be published; None while it is lost."""
        return self.drive.state.position

    def place_at(self, later_ns: int = 0, ahead_m: float = 0.0, east_m: float = 0.0, **changes: Any) -> PlaceFix | None:
        """The same at another moment, once the vehicle has moved on."""
        self.drive.update(self.t_ns + later_ns, OdometryUpdate(self.moved(ahead_m, east_m, **changes)))
        answer = self.ask(later_ns, at="now", moves_autopilot=False)
        return answer.place if isinstance(answer, Fix) else answer.fix


def warm(
    road: Road,
    config: Config | None = None,
    north_m: float = 120.0,
    direction: Direction = "forward",
    sees: Sees | None = None,
    meters: float = 60.0,
    **frame: Any,
) -> Vehicle:
    """A vehicle that has passed as many frames as a line has, and then so many meters of places."""
    one = Vehicle(road, config, north_m, direction)
    one.frame = frame
    one.go(LINE_M, nothing)
    one.go(meters, sees)
    return one


def north_m(place: PlaceFix | None) -> float:
    """Meters north of HOME."""
    assert place is not None and place.lat_deg is not None and place.lon_deg is not None
    return east_north_of(place.lat_deg, place.lon_deg, HOME)[1]


def left_m(place: PlaceFix | None) -> float:
    """Meters west of the road."""
    assert place is not None and place.lat_deg is not None and place.lon_deg is not None
    return -east_north_of(place.lat_deg, place.lon_deg, HOME)[0]
