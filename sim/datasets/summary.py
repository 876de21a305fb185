"""What a recording holds, in a few lines for people: rate, length, gaps, first and last picture."""

from __future__ import annotations

from datetime import datetime, timezone

import numpy as np

from edge.feed import Feed
from sim.datasets import USUAL_FOV
from sim.traverse import driven_m

UNIX_FROM_NS = 10**18
"""Stamps from September 2001 on are Unix times; smaller ones count from the start of a computer or a video."""


def summarize(feed: Feed) -> list[tuple[str, str]]:
    """Pairs of a word and a sentence."""
    rows = feed.rows
    stamps_s = np.array([row.stamp_ns - rows[0].stamp_ns for row in rows]) / 1e9
    gaps_s, meters = np.diff(stamps_s, prepend=0.0), driven_m(feed)
    worst = int(gaps_s.argmax())
    rate = f", {(len(rows) - 1) / stamps_s[-1]:.3g} a second" if stamps_s[-1] > 0 else ""
    lines = [
        (
            "frames",
            f"{len(rows)} of {feed.header.width} x {feed.header.height} pixels{rate}; {feed.header.view} camera",
        ),
        ("time", f"{_spell_s(float(stamps_s[-1]))}{_since(rows[0].stamp_ns)}"),
    ]
    if meters is None:
        lines.append(("length", "not known: not every frame has a position or a distance"))
    else:
        step_m = f", a frame every {meters[-1] / (len(rows) - 1):.2g} m" if len(rows) > 1 else ""
        lines.append(("length", f"{meters[-1]:.0f} m{step_m}"))
    fov_deg = feed.header.fov_deg
    unknown = f"not known, and taken as 75 ± 10 degrees by keypoints; --fov-deg DEG says it ({USUAL_FOV})"
    lines.append(("field of view", unknown if fov_deg is None else f"{fov_deg:.1f} degrees"))
    placed = sum(row.lat_deg is not None for row in rows)
    sources = sorted({row.position_source for row in rows if row.lat_deg is not None})
    lines.append(("positions", f"{placed} of {len(rows)} frames ({', '.join(sources)})" if placed else "none"))
    lines.append(("longest gap", f"{gaps_s[worst]:.1f} s{_meters(meters, worst)}, before frame {worst}"))
    named = [row.extra.get("source_file") or row.file for row in (rows[0], rows[-1])]
    lines.append(("pictures", f"{named[0]} to {named[1]}, from {feed.header.source or feed.path.name}"))
    return [*lines, *([("notes", feed.header.notes)] if feed.header.notes else [])]


def _meters(meters: list[float] | None, row: int) -> str:
    return f", {meters[row] - meters[row - 1]:.1f} m" if meters and row else ""


def _spell_s(seconds: float) -> str:
    return f"{seconds:.1f} s" if seconds < 120 else f"{seconds / 60:.1f} min"


def _since(stamp_ns: int) -> str:
    if stamp_ns < UNIX_FROM_NS:
        return ""
    return f" from {datetime.fromtimestamp(stamp_ns / 1e9, tz=timezone.utc):%Y-%m-%d %H:%M:%S} UTC"
