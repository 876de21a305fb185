"""The named courses of `lookback dev sim fixes`: what can go wrong on a drive, each with the rules that it must pass.

A course is a function of a draft: a road of some length, a seeded generator, and what is usual (home at night over a
road that is mapped whole, GPS lost after 9 s, the autopilot steering itself). It changes what its case is about.
"""

from sim.research.trial.course import CASES, COURSES, courses_of
from sim.research.trial.courses import gps, home, links, maps, motion, streams

__all__ = ["CASES", "COURSES", "courses_of", "gps", "home", "links", "maps", "motion", "streams"]
