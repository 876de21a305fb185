"""What a way becomes on a course that leaves the mapped road, circles, or is carried."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from sim.research.trial.course import CourseDraft
from sim.trial.way import Leg, Way, along


def placed(way: Way, east_m: float, north_m: float, heading_rad: float) -> Way:
    """The same way from another start, turned to start at that heading; the views stay."""
    turn = heading_rad - way.heading_rad[0]
    east, north = way.east_m - way.east_m[0], way.north_m - way.north_m[0]
    return replace(
        way,
        east_m=east_m + east * np.cos(turn) + north * np.sin(turn),
        north_m=north_m + north * np.cos(turn) - east * np.sin(turn),
        heading_rad=way.heading_rad + turn,
    )


def joined(way: Way, other: Way) -> Way:
    """A way and then another, which lies where the first one ends, in its direction."""
    return way.then(placed(other, *way.at(way.length_m)))


def carried_on(way: Way, length_m: int) -> Way:
    """A way and then a straight line on which the vehicle is carried and sees what it saw last."""
    heading, steps = way.heading_rad[-1], np.arange(1, length_m + 1)
    line = replace(
        way.stays(length_m),
        east_m=way.east_m[-1] + steps * np.sin(heading),
        north_m=way.north_m[-1] + steps * np.cos(heading),
        carried=np.ones(length_m, bool),
    )
    return way.then(line)


def carried_to(way: Way, other: Way, rows: int = 4) -> Way:
    """A way, and another that the vehicle is carried to within `rows` / 8 s, while it sees what it saw last."""
    share = np.arange(1, rows + 1) / (rows + 1)
    between = replace(
        way.stays(rows),
        east_m=way.east_m[-1] + share * (other.east_m[0] - way.east_m[-1]),
        north_m=way.north_m[-1] + share * (other.north_m[0] - way.north_m[-1]),
        carried=np.ones(rows, bool),
    )
    return way.then(between).then(other)


def towed(way: Way, start_m: int, end_m: int) -> Way:
    """The same, but carried from one meter to another."""
    carried = way.carried.copy()
    carried[start_m:end_m] = True
    return replace(way, carried=carried)


def bent(way: Way, *, to_the_left: bool = False) -> Way:
    """The same bent into one lap of a circle, to the right or to the left, from its start."""
    around = -2 * np.pi if to_the_left else 2 * np.pi
    turns = np.linspace(0.0, around, len(way.east_m) + 1)[:-1] + way.heading_rad[0]
    east_m = way.east_m[0] + np.cumsum(np.sin(turns)) - np.sin(turns[0])
    north_m = way.north_m[0] + np.cumsum(np.cos(turns)) - np.cos(turns[0])
    return replace(way, east_m=east_m, north_m=north_m, heading_rad=turns)


def beside(way: Way, left_m: Callable[[float], float]) -> Way:
    """A way along the same road, to the left of one by what `left_m` gives for each meter of it."""
    lefts_m = np.array([left_m(float(along_m)) for along_m in range(len(way.east_m))])
    points = np.array([way.at(float(m), lateral_m)[:2] for m, lateral_m in enumerate(lefts_m)])
    along_m = np.r_[0.0, np.cumsum(np.hypot(*np.diff(points, axis=0).T))]
    meters = np.arange(along_m[-1])
    steps = np.gradient(points, axis=0)
    heading_rad = np.unwrap(np.arctan2(steps[:, 0], steps[:, 1]))
    heading_rad += 2 * np.pi * round((way.heading_rad[0] - heading_rad[0]) / (2 * np.pi))
    between = {
        name: np.interp(meters, along_m, values)
        for name, values in (
            ("east_m", points[:, 0]),
            ("north_m", points[:, 1]),
            ("heading_rad", heading_rad),
            ("route_m", way.route_m),
            ("turn_deg", way.turn_deg + np.degrees(heading_rad - way.heading_rad)),
            ("lateral_m", way.lateral_m + lefts_m),
        )
    }
    rows = np.searchsorted(along_m, meters).clip(0, len(along_m) - 1)
    return Way(roads=way.roads, road=way.road[rows], carried=way.carried[rows], **between)


def turned_twice(draft: CourseDraft, start_m: float) -> tuple[Way, list[Leg]]:
    """Out by day from a meter of the road to its middle, 200 m back, and out again to its end."""
    middle_m, lane_m = draft.share(0.5), draft.home.lane_m
    day, back = (draft.road(light="day", direction=one, drive_seed=1) for one in ("forward", "reverse"))
    first = along(day, start_m, middle_m).turned(180.0, radius_m=lane_m)
    second = first.then(along(back, middle_m, middle_m - 200.0)).turned(180.0, radius_m=lane_m)
    way = second.then(along(day, middle_m - 200.0, draft.length_m))
    turns = [(Leg(end.length_m - 6), Leg(end.length_m + 5, 2.0)) for end in (first, second)]
    return way, [*turns[0], *turns[1]]
