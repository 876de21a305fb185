"""F: an odometer, a heading, a map and a clock that are not as usual."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from sim.research.trial.course import CourseDraft
from sim.research.trial.course_rules import USUAL, resumes, sends
from sim.research.trial.courses.registry import course


@course("F", "odometer{:+d}", -15, -3, 3, 12)
def _odometer(draft: CourseDraft, value: int) -> None:
    """The wheels measure so many percent too much."""
    draft.errors = replace(draft.errors, scale=1.0 + value / 100.0)


@course("F", "wheels-slip{:+d}", -12, 10)
def _wheels_slip(draft: CourseDraft, value: int) -> None:
    """The wheels measure so many percent more from the middle of the way on, as on another surface."""
    draft.errors = replace(draft.errors, slips=1.0 + value / 100.0, slips_from_m=draft.share(0.45))


@course("F", "wheels-spin")
def _wheels_spin(draft: CourseDraft) -> None:
    """The wheels turn 1.5 times too fast for 3 s of every 20 s."""
    draft.errors = replace(draft.errors, spins=1.5)


@course("F", "heading-3")
def _heading(draft: CourseDraft) -> None:
    """Dead reckoning goes 3 degrees to the side all the time."""
    draft.errors = replace(draft.errors, heading_deg=3.0 * np.sign(draft.errors.heading_deg))


@course("F", "irregular-map", rules=(*USUAL, sends))
def _irregular(draft: CourseDraft) -> None:
    """Places every 1 to 5 m."""
    draft.map = [replace(draft.map[0], spacing_m=(1.0, 5.0))]


@course("F", "no-headings", rules=(*USUAL, sends))
def _no_headings(draft: CourseDraft) -> None:
    """A map whose places have no heading."""
    draft.map = [replace(draft.map[0], headings=False)]


@course("F", "antimeridian", rules=(*USUAL, sends))
def _antimeridian(draft: CourseDraft) -> None:
    """The road crosses 180 degrees."""
    middle_lon_deg = np.degrees(draft.way.at(draft.way.length_m / 2)[0] / (6378137.0 * math.cos(math.radians(27.4772))))
    draft.lon_shift_deg = float(180.0 - 153.0283 - middle_lon_deg)


@course("F", "clock-wrap", rules=(*USUAL, resumes))
def _clock_wrap(draft: CourseDraft) -> None:
    """The autopilot's clock in milliseconds wraps in the middle of the drive, 49.7 days after boot."""
    draft.booted_before_s = 2**32 / 1e3 - draft.share(0.6) / 8.0
