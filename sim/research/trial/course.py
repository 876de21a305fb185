"""A drive of a course before it is driven: the map, the autopilot, and what will go wrong."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from edge.telemetry.codec import Message
from sim.research.trial.course_rules import USUAL, Rule
from sim.trial.draft import Draft
from sim.trial.way import along
from sim.vehicle.gps import NO_FIX, GpsReport
from sim.world.scenario import LightName, View

GPS_S = 9.0
DOWN_S = (6.0, 10.0)
"""From the death of the daemon to its first message, as recorded on a vehicle's computer."""
ORIGIN_OFF_M = (6.0, 0.0)
CONFIRMED_M = 400.0
"""Without position aiding, so far the map is driven before a fix is sent: a sequence of 80 m, two segments that are
160 m apart by displacement, and a margin for bends and for frames that are not recognized."""


@dataclass(frozen=True)
class MapStretch:
    """A part of the road that the map knows, by its arc lengths.

    off_m: east and north, by how much its positions are wrong, within the arc lengths `off_within_m`. late_m: its
    pictures are so many meters further along than their positions, and nobody has aligned them. left_m: beside
    the lane, as on another drive. on_way: places lie on the drive's way instead of the road, where the way was bent.
    spacing_m: the least and the greatest distance between places. headings: whether the places have one. recording: the
    drive that it was mapped on, where several stretches are of one. appearance: seed of the road that it looks like,
    where that is another. camera: view, light and seed of the drive.
    """

    start_m: float
    end_m: float
    off_m: tuple[float, float] = (0.0, 0.0)
    off_within_m: tuple[float, float] = (-math.inf, math.inf)
    late_m: float = 0.0
    left_m: float = 0.0
    on_way: bool = False
    spacing_m: tuple[float, float] = (2.0, 2.0)
    headings: bool = True
    recording: str = ""
    appearance: int | None = None
    camera: tuple[View, LightName, int] = ("rear", "day", 1)

    @property
    def is_true(self) -> bool:
        """Whether its positions are right."""
        return self.off_m == (0.0, 0.0) and not self.late_m


@dataclass
class CourseDraft(Draft):
    """One seeded drive of a course: usually home over a road that is mapped whole, GPS lost after GPS_S.

    killed_s: when the daemon dies at once, to be back after down_s. restarted_s: when the autopilot does. loses:
    whether the link loses a message, given seconds and whether it is the autopilot's own. silence_s: from when to when
    the autopilot sends nothing but heartbeats. maps_live: the map is made while driving, with a second camera, instead
    of before. unseen_s: from when to when that one, or else the only one, gives no frame. doubted_gps: of [gates]; with
    "send" the autopilot runs our script. steers: whether the autopilot drives, or a person. unsent: parts of the way on
    which no position may be expected. origin_off_m: east and north of the start, where the daemon's configuration has
    an origin; by default ORIGIN_OFF_M without GPS. seen_m: the arc length that a road looks like at another, for roads
    that repeat. frozen_s: from when to when the picture stands still. late_s: by how much pictures are older than they
    say, those of a stream; they are rendered then. clock_off_s: by how much the autopilot's TIMESYNC is ahead of its
    messages. companion_s: how often another companion computer resets the autopilot. motion: [motion] use; unless it is
    "off", pictures are rendered. height: of the camera, as if it was learned before, in true ones. shown_m: the arc
    length of the road in a picture, at that of the camera: of a camera that is lower by a tenth it passes by a tenth
    faster. keypoint_rules: see `course`.
    """

    map: list[MapStretch] = field(init=False)
    rules: tuple[Rule, ...] = USUAL
    keypoint_rules: tuple[Rule, ...] = ()
    firmware: str = "ardupilot"
    emit: str = "auto"
    steers: bool = True
    gps_at: Callable[[float], GpsReport] = lambda time_s: GpsReport() if time_s < GPS_S else NO_FIX
    has_gps: bool = True
    maps_live: bool = False
    unseen_s: tuple[float, float] = (math.inf, math.inf)
    loses: Callable[[float, Message, bool], bool] = lambda time_s, message, outgoing: False
    silence_s: tuple[float, float] | None = None
    killed_s: float | None = None
    restarted_s: float | None = None
    doubted_gps: Literal["report", "switch", "send"] = "report"
    booted_before_s: float = 0.0
    unsent: list[tuple[float, float]] = field(default_factory=list)
    origin_off_m: tuple[float, float] | None = None
    seen_m: Callable[[float], float] = lambda route_m: route_m
    frozen_s: tuple[float, float] = (math.inf, math.inf)
    late_s: float = 0.0
    clock_off_s: float = 0.0
    companion_s: float = math.inf
    down_s: float = 0.0
    motion: Literal["off", "odometer", "send"] = "off"
    height: float | None = None
    shown_m: Callable[[float], float] = lambda route_m: route_m

    def __post_init__(self) -> None:
        super().__post_init__()
        self.map = [MapStretch(0.0, self.length_m)]
        self.drive(along(self.home, self.length_m, 0.0))

    @property
    def origin_m(self) -> tuple[float, float] | None:
        """The origin of the daemon's configuration, meters east and north of the simulation's."""
        off_m = self.origin_off_m or (None if self.has_gps else ORIGIN_OFF_M)
        east_m, north_m, _ = self.way.at(0.0)
        return (east_m + off_m[0], north_m + off_m[1]) if off_m else None

    def share(self, share: float) -> float:
        """Meters of the way, or of the road, at a share of the length."""
        return round(share * self.length_m)

    def side(self, off_m: float, turn_rad: float = np.pi / 2) -> tuple[float, float]:
        """An offset, east and north, to the right of the way home in its middle, or in another direction."""
        heading = along(self.home, self.length_m / 2, self.length_m / 2 - 2).heading_rad[0] + turn_rad
        return off_m * float(np.sin(heading)), off_m * float(np.cos(heading))


def is_command(message: Message, command: int) -> bool:
    """Whether a message is this command, as COMMAND_LONG or COMMAND_INT."""
    return bool(getattr(message, "command", None) == command)


@dataclass(frozen=True)
class Course:
    """A drive that something may go wrong on.

    lay: changes the usual draft. about: a line for people. least_m: the shortest road on which it can be driven.
    """

    case: str
    lay: Callable[[CourseDraft], None]
    about: str
    least_m: float = 0.0


def drafted(course: Course, seed: int, length_m: float, world: int) -> CourseDraft:
    """The course of a seed."""
    draft = CourseDraft(np.random.default_rng([seed, 7]), max(length_m, course.least_m), world)
    course.lay(draft)
    return draft


CASES = {
    "A": "one mapped stretch",
    "B": "turn-off, U-turn, reversing, stop, ferry, tow",
    "C": "maps that are wrong, and no GPS from boot",
    "D": "GPS that is lost, comes and goes, or is spoofed",
    "E": "lost messages, silence, restarts",
    "F": "odometer, heading, map and clock",
    "G": "home, steering itself",
    "H": "PX4, and streams",
    "J": "PX4 that nothing but the camera gives a speed",
    "L": "a vehicle that stands where nobody knows, or was carried there",
}

COURSES: dict[str, Course] = {}


def course(
    case: str,
    name: str,
    *values: object,
    rules: tuple[Rule, ...] = USUAL,
    keypoint_rules: tuple[Rule, ...] = (),
    least_m: float = 0.0,
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Add a course to a case, or one for each value; `name` has the value's place. Its docstring says what it is.

    rules: that it must pass, unless the course sets others. keypoint_rules: further ones on a map with keypoints, see
    `on_keypoints`.
    """

    def add(function: Callable[..., None]) -> Callable[..., None]:
        about = " ".join((function.__doc__ or "").split())
        arguments: list[tuple[object, ...]] = [(value,) for value in values] or [()]
        for given in arguments:

            def lay(draft: CourseDraft, given: tuple[object, ...] = given) -> None:
                draft.rules, draft.keypoint_rules = rules, keypoint_rules
                function(draft, *given)

            COURSES[name.format(*given)] = Course(case, lay, about, least_m)
        return function

    return add


def courses_of(case: str) -> list[str]:
    """The names of a case's courses."""
    return [name for name, one in COURSES.items() if one.case == case]
