"""A and C: maps of a part of the road, and maps that are wrong."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from sim.research.trial import course_rules as rule
from sim.research.trial.course import CONFIRMED_M, GPS_S, Course, CourseDraft, MapStretch, course
from sim.research.trial.ways import bent, beside
from sim.trial.way import along
from sim.vehicle.gps import NO_FIX, GpsReport

FALSE_BY_M, TWIN_M, CHANGES_M = 300.0, 25.0, 60.0


@course("A", "one-stretch")
def _one_stretch(draft: CourseDraft) -> None:
    """One stretch of 220 m is known, and entered, left and seen from everywhere else."""
    start_m = draft.rng.integers(22) / 21 * (draft.length_m - 220.0)
    draft.map = [MapStretch(start_m, start_m + 220.0)]


@course("C", "false-{}", 140, 260, 400, rules=(*rule.USUAL, rule.resumes))
def _false(draft: CourseDraft, value: float) -> None:
    """Part of the map is 300 m wrong, and GPS fails before it is reached."""
    start_m = draft.share(0.3)
    end_m = min(start_m + value, draft.length_m - 60)
    draft.map = [
        MapStretch(0.0, start_m),
        MapStretch(start_m, end_m, off_m=draft.side(FALSE_BY_M)),
        MapStretch(end_m, draft.length_m),
    ]
    draft.unsent = [(draft.length_m - end_m, draft.length_m - start_m + 240)]


@course("C", "false-{}-no-gps", 140, 260, 400)
def _false_no_gps(draft: CourseDraft, value: float) -> None:
    """The same without GPS from boot: nothing but the wrong stretch is known for the first half of the way."""
    _false(draft, value)
    draft.map = [MapStretch(0.0, draft.share(0.15)), draft.map[1]]
    draft.has_gps = False


@course("C", "false-within-400-no-gps", least_m=1200.0)
def _false_within(draft: CourseDraft) -> None:
    """400 m within one drive of the map are 300 m wrong, and met first; no GPS from boot, a person drives."""
    off_m, off_within_m = draft.side(FALSE_BY_M), (draft.length_m - 420.0, draft.length_m - 20.0)
    draft.map = [MapStretch(0.0, draft.length_m, off_m=off_m, off_within_m=off_within_m)]
    draft.has_gps = draft.steers = False


@course("C", "false-recording-{}", 24, 60)
def _false_recording(draft: CourseDraft, value: float) -> None:
    """410 m of the map are 150 m wrong in two segments of one recording, so far apart; no GPS, a person drives."""
    off_m, name = draft.side(150.0), "a recording"
    first = MapStretch(60.0, 265.0, off_m=off_m, recording=name)
    draft.map = [first, MapStretch(265.0 + value, 470.0 + value, off_m=off_m, recording=name)]
    draft.has_gps = draft.steers = False


@course("C", "repeats-{}", 240, 320)
def _repeats(draft: CourseDraft, value: float) -> None:
    """Blocks of so many meters all look like the first."""
    draft.seen_m = lambda route_m: route_m % value
    draft.unsent = [(0.0, math.inf)]


@course("C", "alike-{}-aside", 25, 100)
def _alike(draft: CourseDraft, value: float) -> None:
    """The drive is so far to the side of the mapped road, on one that looks the same, as a motorway's other side."""
    (east_m, north_m), way = draft.side(value * draft.rng.choice((-1.0, 1.0))), draft.way
    draft.drive(replace(way, east_m=way.east_m + east_m, north_m=way.north_m + north_m))
    draft.unsent = [(0.0, math.inf)]


@course("C", "twin-after-{}", 100, 300)
def _twin_after(draft: CourseDraft, value: float) -> None:
    """So many meters after GPS was lost, a person changes to a street 25 m beside, which looks the same."""
    after_m, side = 8.0 * GPS_S + value, draft.rng.choice((-1.0, 1.0))
    way = beside(draft.way, lambda m: side * TWIN_M * min(max((m - after_m) / CHANGES_M, 0.0), 1.0))
    is_there = np.abs(way.lateral_m) >= TWIN_M
    draft.drive(replace(way, lateral_m=np.where(is_there, 0.0, way.lateral_m)))
    draft.steers, draft.unsent = False, [(after_m, math.inf)]


@course("C", "late-30", rules=rule.HONEST)
def _late(draft: CourseDraft) -> None:
    """The map is of a recording whose pictures are 30 m late, and which nobody has aligned."""
    draft.map = [MapStretch(0.0, draft.length_m, late_m=30.0)]


@course("C", "recording-{}", "25-ahead", "12-aside", least_m=1200.0, rules=(*rule.HONEST, rule.never_called))
def _recording_off(draft: CourseDraft, value: str) -> None:
    """400 m of a recording are off, ahead or to the side, as another carriageway; GPS is right, and lost at their end,
    and a person drives. 12 m to the side is no more than multipath; of 25 m ahead the pilot is told."""
    far_m, way = value.split("-")
    from_m, to_m = draft.length_m - 700.0, draft.length_m - 300.0
    off_m = draft.side(float(far_m) * draft.rng.choice((-1.0, 1.0)), 0.0 if way == "ahead" else np.pi / 2)
    draft.map = [MapStretch(0.0, draft.length_m, off_m=off_m, off_within_m=(from_m, to_m))]
    draft.gps_at = lambda time_s: GpsReport() if time_s < 650.0 / 8.0 else NO_FIX
    draft.steers = False
    if way == "ahead":
        draft.rules = (*draft.rules, rule.told_after(300.0))


@course("C", "far-origin", least_m=1200.0, rules=(*rule.USUAL, rule.sends))
def _far_origin(draft: CourseDraft) -> None:
    """No GPS from boot, and an origin that was set by hand 260 m off; a person drives, and the map is right."""
    _no_gps(draft)
    draft.origin_off_m = draft.side(260.0)


@course("C", "no-gps", least_m=1200.0, rules=(*rule.USUAL, rule.sends))
def _no_gps(draft: CourseDraft) -> None:
    """No GPS from boot, and an origin that was set by hand 6 m off; a person drives, and the map is right."""
    draft.has_gps = draft.steers = False
    draft.unsent = [(0.0, CONFIRMED_M)]


@course("C", "shifted-40", rules=(rule.within_sigmas, rule.not_worse))
def _shifted(draft: CourseDraft) -> None:
    """The whole map is 40 m wrong."""
    draft.map = [MapStretch(0.0, draft.length_m, off_m=draft.side(40.0))]


@course("C", "two-drives-40", rules=(rule.within_sigmas, rule.not_worse))
def _two_drives(draft: CourseDraft) -> None:
    """Two drives over the road disagree by 40 m, and nobody says which of them is right."""
    draft.map = [MapStretch(0.0, draft.length_m), MapStretch(0.0, draft.length_m, left_m=1.0, off_m=draft.side(40.0))]


@course("C", "two-laps", rules=rule.HONEST)
def _two_laps(draft: CourseDraft) -> None:
    """Laps of 120 m whose places are 300 m wrong, without GPS from boot: a lap must not confirm another."""
    start_m = draft.length_m / 2
    lap = bent(along(draft.home, start_m + 119, start_m))
    draft.drive(lap.then(lap).then(lap).then(lap))
    draft.map = [MapStretch(start_m, start_m + 119, on_way=True, off_m=draft.side(FALSE_BY_M))]
    draft.has_gps, draft.steers = False, False


def on_keypoints(one: Course) -> Course:
    """The course on a map with keypoints, its camera's pictures rendered; where it maps live, that map has them too."""

    def lay(draft: CourseDraft) -> None:
        one.lay(draft)
        draft.keypoints, draft.rules = True, (*draft.rules, *draft.keypoint_rules)

    return replace(one, lay=lay)
