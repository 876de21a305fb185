"""The figures of the courses' drives, as lines and as a table in Markdown."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from edge.errors import ConfigError
from sim.research.trial.course_rules import WRONG_M, CourseRun
from sim.trial.records import Array, lane_off_m

BEYOND_SIGMAS, BEYOND_SHARE = 3.0, 0.003
RMS = (0.8, 1.1)
ENOUGH_RUNS = 20
"""Below so many drives a small rms may be chance."""
HEADER = (
    "| course | drives passed | positions | error, median / 95 % / largest | in sigmas, rms / largest"
    " | autopilot's error 95 %, alone | cross-track 95 %, alone | share sent | why not |\n"
    "|---|---|---|---|---|---|---|---|---|"
)


def line(name: str, run: CourseRun) -> str:
    """One drive, for people."""
    verdict = "; ".join(f"{failure.rule}: {failure.found}" for failure in run.failures) or "passed"
    ends = ", ".join(f"{track.end_off_m:.0f} m" for track in (run.track, run.alone))
    sent = run.sent
    lanes = ", ".join(f"{lane_off_m(track):.1f} m" for track in (run.track, run.alone))
    return (
        f"{name:<26} seed {run.seed:3d} road {run.world:3d}  {len(sent.time_s):4d} positions  {_spread(sent.error_m)}"
        f"  first known after {run.known_after_m:.0f} m, sent after {run.first_after_m:.0f} m"
        f"  believed {run.believed} of {run.used}, wrong {run.wrong}"
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

    def row(self) -> str:
        """A row of the table."""
        runs, sigmas = self.runs, self.sigmas
        cells = (
            self.name,
            f"{self.passed} of {len(runs)}",
            f"{len(sigmas)}",
            _spread(np.concatenate([run.sent.error_m for run in runs])),
            f"{_rms(sigmas):.1f} / {sigmas.max():.1f}" if len(sigmas) else "-",
            _beside([run.track.error_m for run in runs], [run.alone.error_m for run in runs]),
            _beside([abs(run.track.left_m) for run in runs], [abs(run.alone.left_m) for run in runs]),
            f"{np.nanmean([run.share_sent for run in runs]):.2f}" if any(r.expected.any() for r in runs) else "-",
            "; ".join(self.failures),
        )
        return "| " + " | ".join(cells) + " |"


def in_short(scores: Sequence[CourseScore]) -> str:
    """A table of cases, or of courses where there are none; the courses of which a drive fails; how many pass."""
    several, courses = [one for one in scores if one.is_several], [one for one in scores if not one.is_several]
    passed, failed = [one for one in courses if one.passes], [one for one in courses if not one.passes]
    odd = ", ".join(f"`{one.name}` ({one.odd_rms})" for one in passed if one.odd_rms)
    rows = [HEADER, *(one.row() for one in several or failed)]
    lines = [*(_short(row, with_why=not several) for row in rows), ""]
    if several and failed:
        named = (f"`{one.name}`: {', '.join(one.failures)}" for one in failed)
        lines += [f"Not as required: {'; '.join(named)}.", ""]
    return "\n".join([*lines, f"All drives of {len(passed)} courses pass{f', {odd} among them' if odd else ''}."])


def looks_table(scores: Sequence[CourseScore]) -> str:
    """How far positions are from the lane that was taught, where the map with its GPS has it.

    scores: pairs, of maps without and with keypoints.
    """
    head = (
        "| course | positions | from the taught lane: along | across | heading, rms | in sigmas, rms / largest"
        " | cross-track 95 %, alone | first after | believed | wrong |\n|---|---|---|---|---|---|---|---|---|---|"
    )
    rows = []
    for one in scores:
        lane_m, sigmas = np.concatenate([run.lane_m for run in one.runs]), one.sigmas
        turned_deg, used = np.concatenate([run.turned_deg for run in one.runs]), sum(run.used for run in one.runs)
        cells = (
            one.name,
            f"{len(sigmas)}",
            _halves(lane_m[:, 0]),
            _halves(lane_m[:, 1]),
            f"{_rms(turned_deg):.2f} deg" if len(turned_deg) else "-",
            f"{_rms(sigmas):.2f} / {sigmas.max():.1f}" if len(sigmas) else "-",
            _beside([abs(run.track.left_m) for run in one.runs], [abs(run.alone.left_m) for run in one.runs]),
            f"{np.nanmedian([run.first_after_m for run in one.runs]):.0f} m",
            f"{sum(run.believed for run in one.runs)} of {used}",
            f"{sum(run.wrong for run in one.runs)}",
        )
        rows.append("| " + " | ".join(cells) + " |")
    return "\n".join([head, *rows])


def known_table(scores: Sequence[CourseScore]) -> str:
    """When a place is believed where nobody knew the vehicle; scores: pairs, of maps without and with keypoints."""
    rows = [
        "| course | drives | place believed after | positions | in sigmas, largest | wrong |\n|---|---|---|---|---|---|"
    ]
    for one in scores:
        cells = (
            one.name,
            f"{len(one.runs)}",
            ", ".join("-" if math.isnan(run.known_after_m) else f"{run.known_after_m:.0f} m" for run in one.runs),
            f"{len(one.sigmas)}",
            f"{one.sigmas.max():.1f}" if len(one.sigmas) else "-",
            f"{sum(int((run.known[:, 1] > WRONG_M).sum()) for run in one.runs)}",
        )
        rows.append("| " + " | ".join(cells) + " |")
    return "\n".join(rows)


def odometers_table(scores: Sequence[CourseScore]) -> str:
    """What the autopilot made of positions, by lines, by looks where there are any, and without Lookback.

    scores: of a course and an odometer, without and perhaps with keypoints: one row.
    """
    drives: dict[str, dict[str, tuple[CourseRun, ...]]] = {}
    for one in scores:
        name, _, what = one.name.rpartition(", ")
        drives.setdefault(name, {})[what] = one.runs
    said = "95 %: " + ", ".join([*next(iter(drives.values())), "alone"])
    rows = [f"| course | autopilot's error {said} | cross-track {said} |\n|---|---|---|"]
    for name, both in drives.items():
        tracks = [[run.track for run in runs] for runs in both.values()]
        tracks.append([run.alone for run in next(iter(both.values()))])
        error_m = ([track.error_m for track in of] for of in tracks)
        left_m = ([np.abs(track.left_m) for track in of] for of in tracks)
        cells = (", ".join(_most(one) for one in of) for of in (error_m, left_m))
        rows.append(f"| {name} | {' m | '.join(cells)} m |")
    return "\n".join(rows)


def _halves(off_m: Array) -> str:
    return " / ".join(f"{one:.2f}" for one in np.percentile(np.abs(off_m), (50, 95))) + " m" if len(off_m) else "-"


def _short(rows: str, *, with_why: bool) -> str:
    """Rows without the autopilot's error, which says little over several courses, and the share sent."""
    cells = (row.split("|") for row in rows.splitlines())
    return "\n".join("|".join([*one[:6], one[7], *one[9 if with_why else 10 :]]) for one in cells)


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
    if not len(errors_m):
        return "-"
    return " / ".join(f"{one:.1f}" for one in np.percentile(errors_m, (50, 95, 100))) + " m"


def _beside(ours: Sequence[Array], alone: Sequence[Array]) -> str:
    return " m, ".join(_most(values) for values in (ours, alone)) + " m"


def _most(off_m: Sequence[Array]) -> str:
    return f"{np.percentile(np.concatenate(off_m), 95):.1f}"
