"""The named courses of `lookback dev sim fixes`: what can go wrong on a drive, each with the rules that it must pass.

A course is a function of a draft: a road of some length, a seeded generator, and what is usual (home at night over a
road that is mapped whole, GPS lost after 9 s, the autopilot steering itself). It changes what its case is about.
"""

from sim.research.trial.courses import errors, gps, home, links, maps, motion, streams
from sim.research.trial.courses.registry import CASES, COURSES, courses_of

__all__ = ["CASES", "COURSES", "courses_of", "errors", "gps", "home", "links", "maps", "motion", "streams"]
