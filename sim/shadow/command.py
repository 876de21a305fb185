"""`lookback shadow`: how far off positions would have been on drives beside GPS, and where they are good enough."""

from __future__ import annotations

import argparse
import csv
import io
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from edge.config import GatesConfig
from edge.errors import ConfigError
from sim.coverage.picture import UNKNOWN, Band, write_page
from sim.ground_files import GroundLine, as_geojson, write_by_suffix
from sim.shadow.drives import JUDGED_SHARE, LIGHTS, MOST_GPS_M, ShadowDrive, read_drives
from sim.shadow.judging import MORE, Factor, GpsComparison, Road, SpanReadiness, compared, judge, ready_m

READY, UNTRIED, NOT_READY = "#0072B2", "#E69F00", "#D55E00"
LEGEND = ((READY, "ready"), (UNTRIED, MORE), (NOT_READY, "not ready"), (UNKNOWN, "not driven in this light"))
AXES = ("along", "across")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of `lookback shadow`."""
    parser.description = (
        'Judge Lookback by GPS, after drives with [telemetry] emit = "report": for each stretch of road and each light,'
        " how far off its positions would have been, whether their standard deviations were true, and how long none"
        " came. GPS is counted as wrong as it says it is; a drive with a poor one judges nothing."
    )
    about = "of drives beside GPS; earlier files of a journal (.1, .2) are read with it"
    parser.add_argument("journals", nargs="+", type=Path, metavar="JOURNAL", help=about)
    parser.add_argument("--since", type=datetime.fromisoformat, metavar="DATE", help="only drives from then on")
    parser.add_argument("--light", choices=LIGHTS, help="only what was driven in it, by the sun")
    about = "drives in one light that a stretch needs to be ready (default 3)"
    parser.add_argument("--drives", type=int, default=3, metavar="N", help=about)
    about = "error, and drift where nothing comes, that is accepted (default 20)"
    parser.add_argument("--within-m", type=float, default=20.0, metavar="M", help=about)
    parser.add_argument("--stretch-m", type=float, default=100.0, metavar="M", help="length of a stretch (default 100)")
    about = "write the stretches as well (.csv, .geojson)"
    parser.add_argument("-o", "--output", type=Path, metavar="FILE", help=about)
    parser.add_argument("--report", type=Path, metavar="FILE", help="draw them on a page (HTML)")
    parser.set_defaults(run=_run)


@dataclass(frozen=True)
class Report:
    """What all drives say. judges: those whose GPS was good enough. lights: what each light says, by its name."""

    drives: list[ShadowDrive]
    judges: list[ShadowDrive]
    lights: dict[str, GpsComparison]
    stretches: list[SpanReadiness]


def report(
    drives: list[ShadowDrive], *, light: str | None, fewest: int, within_m: float, stretch_m: float, drift: float
) -> Report:
    """light: only what was driven in it. fewest: drives that a stretch needs. drift: of the distance, a share."""
    judges = [one for one in drives if one.is_judge]
    road = Road(stretch_m)
    spans = [road.follow(one) for one in judges]
    wanted = [row for row, name in enumerate(LIGHTS) if light in (None, name)]
    lit = {LIGHTS[row]: [one.light == row for one in judges] for row in wanted if judges}
    found = {name: one for name, rows in lit.items() if len((one := compared(judges, rows)).gps_m)}
    limits = {"fewest": fewest, "within_m": within_m, "drift": drift}
    stretches = (
        judge(span, row, judges, [one == number for one in spans], **limits)  # type: ignore[arg-type]
        for row in wanted
        for number, span in enumerate(road.spans)
    )
    return Report(drives, judges, found, [one for one in stretches if one is not None])


def _run(args: argparse.Namespace) -> int:
    for option, value in (("--within-m", args.within_m), ("--stretch-m", args.stretch_m), ("--drives", args.drives)):
        if not value > 0:
            raise ConfigError(f"{option}: {value:g} is not above 0")
    drives = read_drives(args.journals, args.since.timestamp() if args.since else -math.inf)
    limits = {"fewest": args.drives, "within_m": args.within_m, "drift": GatesConfig().drift_percent / 100}
    found = report(drives, light=args.light, stretch_m=args.stretch_m, **limits)
    print("\n".join(text(found)))
    if args.output:
        write_by_suffix(args.output, {".csv": lambda: _csv(found), ".geojson": lambda: _geojson(found)})
    if args.report:
        _draw(args.report, found)
    return 0


def text(found: Report) -> Iterator[str]:
    """For people: the drives, each light with its stretches, and the verdict."""
    yield f"{_drives(found.drives)}, of which GPS can judge {_drives(found.judges)}"
    for one in found.drives:
        if not one.is_judge:
            share = f"{100 * one.judged_share:.0f} % of it"
            yield f"  {one.name}: no judge: GPS with an accuracy of {MOST_GPS_M:g} m or better on {share} only"
    for light in LIGHTS:
        stretches = [one for one in found.stretches if one.light == light]
        if stretches:
            yield ""
            yield from _of_light(light, found.lights.get(light), stretches)
    yield ""
    yield from verdict(found)


def _drives(drives: Sequence[ShadowDrive]) -> str:
    driven_m = math.fsum(float(one.driven_m.sum()) for one in drives)
    return f"{len(drives)} drive{'s' * (len(drives) != 1)} ({driven_m:.0f} m)"


def _of_light(light: str, positions: GpsComparison | None, stretches: Sequence[SpanReadiness]) -> Iterator[str]:
    longest_m = max(one.silent_m for one in stretches)
    if positions is None:
        yield f"{light}: no position would have been published"
        return
    ahead_m, left_m = positions.bias_m
    gps_m = math.sqrt(2) * float(np.median(positions.gps_m))
    yield (
        f"{light}: {len(positions.gps_m)} positions, off by {_spread(positions)} (median / 95 % / largest), on average"
        f" {_signed(ahead_m, 'ahead')} and {_signed(left_m, 'to the left')}; GPS itself {gps_m:.1f} m"
    )
    for axis, name in enumerate(AXES):
        yield f"  standard deviation {name} the road: {_factor(positions.factor(axis))}"
    yield f"  {positions.beyond} beyond 3 standard deviations; longest way without a position: {longest_m:.0f} m"
    for one in stretches:
        state = f"not ready: {one.why}" if one.why else "ready"
        off = f", off by {_spread(one.positions)}" if len(one.positions.gps_m) else ""
        yield (
            f"  {one.span.length_m:4.0f} m {one.span.name}: {state}; {one.drives} drives, {100 * one.published:.0f} %"
            f" with a position, {one.silent_m:.0f} m without{off}"
        )


def _spread(positions: GpsComparison) -> str:
    return " / ".join(f"{one:.1f}" for one in positions.spread_m) + " m"


def _signed(value_m: float, words: str) -> str:
    opposite = {"ahead": "behind", "to the left": "to the right"}
    return f"{abs(value_m):.1f} m {words if value_m >= 0 else opposite[words]}"


def _factor(one: Factor | None) -> str:
    if one is None:
        return "too few positions to say"
    state = "too small" if one.is_too_small else "larger than it had to be" if one.is_too_large else "true"
    return f"{state}: {one.best:.2f} times it fits best ({one.least:.2f} to {one.most:.2f})"


def verdict(found: Report) -> Iterator[str]:
    """Where Lookback is ready, by how many drives, and what to change."""
    if not found.judges:
        yield "Not ready: no drive had GPS that can judge. Mount a better receiver, or one that reports its accuracy."
        return
    for light in LIGHTS:
        stretches = [one for one in found.stretches if one.light == light]
        if not stretches:
            continue
        good_m, all_m = ready_m(stretches)
        positions = found.lights.get(light)
        factors = [positions.factor(axis) for axis in range(2)] if positions else []
        small = [(axis, one) for axis, one in enumerate(factors) if one is not None and one.is_too_small]
        state = "Not ready" if small or not good_m else "Ready" if good_m == all_m else "Ready in parts"
        driven_m = math.fsum(one.driven_m for one in stretches)
        drives = max(one.drives for one in stretches)
        yield f"{state} by {light}: {good_m:.0f} of {all_m:.0f} m of road; up to {drives} drives, {driven_m:.0f} m"
        for axis, one in small:
            keys = (
                f"{positions.keys} (where none was set, sigma_along_m)"
                if positions and axis == 0
                else "sigma_cross_track_m"
            )
            yield f"  Multiply [rig] {keys} by {one.best:.1f}, drive again, and judge with --since"


def _rows(found: Report) -> list[dict[str, Any]]:
    rows = []
    for one in found.stretches:
        has = bool(len(one.positions.gps_m))
        spread = one.positions.spread_m if has else (None, None, None)
        factors = [one.positions.factor(axis) for axis in range(2)]
        figures = {
            "lat_deg": one.span.points[0][0],
            "lon_deg": one.span.points[0][1],
            "heading_deg": one.span.heading_deg,
            "length_m": one.span.length_m,
            "driven_m": one.driven_m,
            "published": one.published,
            "silent_m": one.silent_m,
            **dict(zip(("median_m", "p95_m", "max_m"), spread, strict=True)),
            **{f"factor_{name}": f.best if f else None for name, f in zip(AXES, factors, strict=True)},
        }
        known = {
            key: None if value is None else round(value, 7 if "deg" in key else 2) for key, value in figures.items()
        }
        counts = {"drives": one.drives, "positions": len(one.positions.gps_m), "beyond_3": one.positions.beyond}
        rows.append({"light": one.light, **known, **counts, "ready": not one.why, "why": one.why})
    return rows


def _csv(found: Report) -> str:
    rows, stream = _rows(found), io.StringIO()
    writer = csv.DictWriter(stream, list(rows[0]) if rows else [], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return stream.getvalue()


def _geojson(found: Report) -> str:
    rows = zip(found.stretches, _rows(found), strict=True)
    return as_geojson([GroundLine("", one.span.points, properties=row) for one, row in rows])


def _draw(path: Path, found: Report) -> None:
    lights = [light for light in LIGHTS if any(one.light == light for one in found.stretches)]
    spans = list({id(one.span): one.span for one in found.stretches}.values())
    panels = []
    for light in lights:
        by_span = {id(one.span): one for one in found.stretches if one.light == light}
        bands = [
            Band([(lon, lat) for lat, lon in one.points], one.length_m, _color(by_span.get(id(one))), is_one_way=True)
            for one in spans
        ]
        panels.append((light, bands))
    first, *words = verdict(found)
    judged = (
        f"Judged by GPS on {_drives(found.judges)}; a drive counts if GPS was good on {100 * JUDGED_SHARE:.0f} % of it."
    )
    lines = [first, judged, *words]
    for light, positions in found.lights.items():
        factors = "; ".join(f"{name} {_factor(positions.factor(axis))}" for axis, name in enumerate(AXES))
        lines += [f"{light}: off by {_spread(positions)} (median, 95 %, largest). Standard deviation {factors}."]
    write_page(path, "Where Lookback is ready", lines, panels, LEGEND, "meters of road")


def _color(one: SpanReadiness | None) -> str:
    if one is None:
        return UNKNOWN
    return READY if not one.why else NOT_READY if one.is_tried else UNTRIED
