"""Courses by name and by case."""

from __future__ import annotations

from collections.abc import Callable

from sim.research.trial.course import Course, CourseDraft
from sim.research.trial.course_rules import USUAL, Rule

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
