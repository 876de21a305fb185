"""The figures of the courses' drives, as lines and as a table in Markdown."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import TypeVar

import numpy as np

from edge.errors import ConfigError
from sim.research.trial.course_rules import WRONG_M, CourseRun
from sim.trial.records import Array, lane_off_m

Part = TypeVar("Part")
Done = TypeVar("Done")
BEYOND_SIGMAS, BEYOND_SHARE = 3.0, 0.003
RMS = (0.8, 1.1)
ENOUGH_RUNS = 20
"""Below so many drives a small rms may be chance."""
ALL = (
    "course",
    "drives passed",
    "positions",
    "error, median / 95 % / largest",
    "in sigmas, rms / largest",
    "autopilot's error 95 %, alone",
    "cross-track 95 %, alone",
    "share sent",
    "why not",
)
"""Columns of the table that is printed: cells of `CourseScore`."""
LITTLE_SAID = "autopilot's error 95 %, alone", "share sent"
"""Over several courses."""
TABLES = {
    "known": ("course", "drives", "place accepted after", "positions", "in sigmas, rms / largest", "places wrong"),
    "keypoints": (
        *(
            "course",
            "positions",
            "from the taught lane: along-track",
            "cross-track",
            "heading, rms",
            "in sigmas, rms / largest",
        ),
        *("cross-track 95 %, alone", "first after", "accepted", "wrong"),
    ),
}
"""Columns of the tables in docs, by their marks: of vehicles that nobody knew; and of courses on maps without and with
keypoints, where the map with its GPS has the lane that was taught."""


def line(name: str, run: CourseRun) -> str:
    """One drive, for people."""
    verdict = "; ".join(f"{failure.rule}: {failure.found}" for failure in run.failures) or "passed"
    ends = ", ".join(f"{track.end_off_m:.0f} m" for track in (run.track, run.alone))
    sent = run.sent
    lanes = ", ".join(f"{lane_off_m(track):.1f} m" for track in (run.track, run.alone))
    return (
        f"{name:<26} seed {run.seed:3d} road {run.world:3d}  {len(sent.time_s):4d} positions  {_spread(sent.error_m)}"
        f"  first known after {run.known_after_m:.0f} m, sent after {run.first_after_m:.0f} m"
        f"  accepted {run.believed} of {run.used}, wrong {run.wrong}"
        f"  cross-track, alone: {lanes}  end, alone: {ends}  {verdict}"
    )


@dataclass(frozen=True)
class CourseScore:
    """All drives of one course, or of one case."""

    name: str
    runs: tuple[CourseRun, ...]

    @property
    def is_several(self) -> bool:
        """Whether it is of several courses."""
        return self.name.startswith("**")

    @property
    def sigmas(self) -> Array:
        """Error over sigma of all positions."""
        return np.concatenate([run.sent.sigmas for run in self.runs])

    @property
    def failures(self) -> list[str]:
        """What is not as required, of single drives and of all together, each with how often."""
        counted = Counter(failure.rule for run in self.runs for failure in run.failures)
        found = [f"{rule} ({count})" for rule, count in counted.items()]
        if self.beyond > BEYOND_SHARE:
            found.append(f"{1000 * self.beyond:.0f} in 1,000 beyond 3 sigma")
        if self.odd_rms:
            found.append(f"{self.odd_rms} sigma")
        return found

    @property
    def beyond(self) -> float:
        """The share of positions beyond three sigmas."""
        return float((self.sigmas > BEYOND_SIGMAS).mean()) if len(self.sigmas) else 0.0

    @property
    def odd_rms(self) -> str:
        """The rms of the errors in sigmas where it is not as required, else nothing."""
        rms = _rms(self.sigmas) if len(self.sigmas) else 1.0
        least = RMS[0] if len(self.runs) >= ENOUGH_RUNS else 0.0
        return "" if least <= rms <= RMS[1] else f"rms {rms:.2f}"

    @property
    def passed(self) -> int:
        """How many drives are as required."""
        return sum(not run.failures for run in self.runs)

    @property
    def passes(self) -> bool:
        """Whether each drive is as required, and no more positions than allowed are beyond three sigmas."""
        return self.passed == len(self.runs) and self.beyond <= BEYOND_SHARE

    @property
    def cells(self) -> dict[str, str]:
        """What a table may have of it, by the names of columns."""
        runs, sigmas = self.runs, self.sigmas
        lane_m, turned_deg = (np.concatenate([getattr(run, of) for run in runs]) for of in ("lane_m", "turned_deg"))
        return {
            "course": self.name,
            "drives": f"{len(runs)}",
            "drives passed": f"{self.passed} of {len(runs)}",
            "positions": f"{len(sigmas)}",
            "error, median / 95 % / largest": _spread(np.concatenate([run.sent.error_m for run in runs])),
            "in sigmas, rms / largest": f"{_rms(sigmas):.1f} / {sigmas.max():.1f}" if len(sigmas) else "-",
            "autopilot's error 95 %, alone": _beside([(run.track.error_m, run.alone.error_m) for run in runs]),
            "cross-track 95 %, alone": _beside([(run.track.cross_track_m, run.alone.cross_track_m) for run in runs]),
            "share sent": _mean([run.share_sent for run in runs if run.expected.any()]),
            "why not": "; ".join(self.failures),
            "from the taught lane: along-track": _halves(lane_m[:, 0]),
            "cross-track": _halves(lane_m[:, 1]),
            "heading, rms": f"{_rms(turned_deg):.2f} deg" if len(turned_deg) else "-",
            "first after": _meters(
                np.median([m for run in runs if not math.isnan(m := run.first_after_m)] or [math.nan])
            ),
            "accepted": f"{sum(run.believed for run in runs)} of {sum(run.used for run in runs)}",
            "wrong": f"{sum(run.wrong for run in runs)}",
            "place accepted after": ", ".join(_meters(run.known_after_m) for run in runs),
            "places wrong": f"{sum(int((run.known[:, 1] > WRONG_M).sum()) for run in runs)}",
        }


def shown(scores: Sequence[CourseScore], columns: Sequence[str] = ALL) -> str:
    """A row for each score."""
    cells = [one.cells for one in scores]
    return markdown(columns, ([one[column] for column in columns] for one in cells))


def in_short(scores: Sequence[CourseScore]) -> str:
    """A table of cases, or of courses where there are none; the courses of which a drive fails; how many pass."""
    several, courses = [one for one in scores if one.is_several], [one for one in scores if not one.is_several]
    passed, failed = [one for one in courses if one.passes], [one for one in courses if not one.passes]
    odd = ", ".join(f"`{one.name}` ({one.odd_rms})" for one in passed if one.odd_rms)
    left_out = (*LITTLE_SAID, *(["why not"] if several else []))
    lines = [shown(several or failed, [one for one in ALL if one not in left_out]), ""]
    if several and failed:
        named = (f"`{one.name}`: {', '.join(one.failures)}" for one in failed)
        lines += [f"Not as required: {'; '.join(named)}.", ""]
    return "\n".join([*lines, f"All drives of {len(passed)} courses pass{f', {odd} among them' if odd else ''}."])


def _halves(off_m: Array) -> str:
    return " / ".join(f"{one:.2f}" for one in np.percentile(np.abs(off_m), (50, 95))) + " m" if len(off_m) else "-"


def markdown(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table."""
    return "\n".join([as_row(columns), "|" + "---|" * len(columns), *map(as_row, rows)])


def as_row(cells: Sequence[str]) -> str:
    """Of a table."""
    return f"| {' | '.join(cells)} |"


def spread(median_95_largest: Sequence[float]) -> str:
    """Of errors in meters; of none there is nothing."""
    return " / ".join(f"{one:.1f}" for one in median_95_largest) + " m" if median_95_largest else "-"


def side_by_side(work: Callable[[Part], Done], parts: Sequence[Part], jobs: int) -> Iterator[Done]:
    """What comes of each part, as soon as it does; each road in a process of its own.

    A few pixels of the renderer change with what was rendered in the process before.
    """
    with get_context("spawn").Pool(jobs, maxtasksperchild=1) as pool:
        yield from pool.imap_unordered(work, parts)


def put_between(name: str, page: Path, text: str) -> None:
    """Replace what stands between the two marks of that name on a page; ConfigError where they are missing."""
    marks = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
    before, begin, rest = page.read_text(encoding="utf-8").partition(marks[0])
    _, end, after = rest.partition(marks[1])
    if not end:
        raise ConfigError(f"--page: {page} has no lines {marks[0]!r} and {marks[1]!r} to write between")
    page.write_text(f"{before}{begin}\n\n{text}\n\n{end}{after}", encoding="utf-8")


def _rms(values: Array) -> float:
    return math.sqrt(float(np.mean(values**2)))


def _spread(errors_m: Array) -> str:
    return spread(np.percentile(errors_m, (50, 95, 100)).tolist() if len(errors_m) else [])


def _beside(pairs: Sequence[tuple[Array, Array]]) -> str:
    """With Lookback, and alone."""
    return ", ".join(f"{np.percentile(np.abs(np.concatenate(of)), 95):.1f} m" for of in zip(*pairs, strict=True))


def _mean(shares: Sequence[float]) -> str:
    return f"{np.nanmean(shares):.2f}" if shares else "-"


def _meters(value: float | np.floating) -> str:
    return "-" if math.isnan(value) else f"{value:.0f} m"
