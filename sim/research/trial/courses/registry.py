"""Courses by name and by case."""

from __future__ import annotations

from collections.abc import Callable

from sim.research.trial.course import Course, CourseDraft

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
    "K": "eight drives over one road, of which four are searched",
}


COURSES: dict[str, Course] = {}


def course(
    case: str, name: str, *values: object, least_m: float = 0.0
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Add a course to a case, or one for each value; `name` has the value's place. Its docstring says what it is."""

    def add(function: Callable[..., None]) -> Callable[..., None]:
        about = " ".join((function.__doc__ or "").split())
        for value in values:

            def lay(draft: CourseDraft, value: object = value) -> None:
                function(draft, value)

            COURSES[name.format(value)] = Course(case, lay, about, least_m)
        if not values:
            COURSES[name] = Course(case, function, about, least_m)
        return function

    return add


def courses_of(case: str) -> list[str]:
    """The names of a case's courses."""
    return [name for name, one in COURSES.items() if one.case == case]
