"""Positions over time, and the position of pictures between them."""

from __future__ import annotations

import logging
import math
import re
from bisect import bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import astuple, dataclass
from datetime import datetime, timedelta, timezone
from functools import cache

import numpy as np
from numpy.typing import NDArray
from pyproj import Transformer

from edge.errors import FeedError
from edge.feed import FeedRow
from edge.geodesy import POSITION_SOURCES, PositionSource, east_north, worse_source

Floats = NDArray[np.float64]
log = logging.getLogger(__name__)

LOCAL = " +step +proj=tmerc +lat_0=0 +lon_0=0 +k=1 +ellps=WGS84"
"""A projection that keeps distances: eastings of 500 km, as of UTM without a zone, are 0.3 % too long."""
MAX_GAP_S = 5.0
"""Positions further apart in time than this are not interpolated."""

FARTHEST_NS = 2**62
"""Stamps of 1824 to 2116 fit int64, also their differences; others count as these."""
LONGEST_S = 86_400.0
"""Of one drive: a day. All that is made of a track, such as its motion ten times a second, is bounded by that."""
SWAPPED_S = 1.0
"""By so much stamps may step back: messages that changed places on the way."""
MOST_JUMPS = 0.1
"""Share of positions that may jump: with more the file is in no order of time, as several drives."""

STANDING_M, STANDING_S = 1.0, 2.0
"""GPS positions wander while the vehicle stands: if it takes longer than STANDING_S to move STANDING_M, it stood.
Otherwise a stop at a red light would become a street of pictures."""


@dataclass(frozen=True)
class TrackFix:
    """One measured position; NaN is not known. heading_deg is clockwise from north.

    sigma_m: one standard deviation of the distance from the truth.
    """

    stamp_ns: int
    lat_deg: float
    lon_deg: float
    alt_m: float = math.nan
    heading_deg: float = math.nan
    speed_mps: float = math.nan
    sigma_m: float = math.nan
    source: PositionSource = "unknown"


class Track:
    """The positions of one drive, in the order of their stamps."""

    def __init__(self, source: str, fixes: Iterable[TrackFix], max_gap_s: float = MAX_GAP_S) -> None:
        """FeedError, which names the source, if there are fewer than two.

        Receivers report 0, 0 before they have a fix; of fixes with the same stamp only the first is used. Those whose
        time jumps against their neighbors', in the order given, are dropped with a warning.
        """
        self._source = source
        self._max_gap_ns = max_gap_s * 1e9
        by_stamp: dict[int, TrackFix] = {}
        for fix in _without_jumps(source, [fix for fix in fixes if (fix.lat_deg, fix.lon_deg) != (0.0, 0.0)]):
            by_stamp.setdefault(fix.stamp_ns, fix)
        if len(by_stamp) < 2:
            raise FeedError(f"{source}: {len(by_stamp) or 'no'} position(s) in it, and two at least are needed")
        self.fixes = [by_stamp[stamp_ns] for stamp_ns in sorted(by_stamp)]
        self._stamps_ns = np.array(sorted(by_stamp), dtype=np.int64)
        self._values: Floats = np.array([astuple(fix)[1:-1] for fix in self.fixes], dtype=np.float64)
        self._sources = np.array([POSITION_SOURCES.index(fix.source) for fix in self.fixes])
        self._when, self._where = _without_wandering(self._stamps_ns, self._values[:, 0], self._values[:, 1])

    def covers(self, stamps_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
        """(N,): which times lie between two positions that are not too far apart in time."""
        last = len(self._stamps_ns) - 1
        after = np.clip(np.searchsorted(self._stamps_ns, stamps_ns), 0, last)
        before = np.clip(after - 1, 0, None)
        inside = (stamps_ns >= self._stamps_ns[0]) & (stamps_ns <= self._stamps_ns[last])
        near = self._stamps_ns[after] - self._stamps_ns[before] <= self._max_gap_ns
        return np.asarray(inside & (near | (stamps_ns == self._stamps_ns[after])))

    def at(self, stamps_ns: NDArray[np.int64]) -> list[TrackFix]:
        """Positions at these times, linear between the fixes; the ends hold beyond them."""
        # From the first fix, as nanoseconds since 1970 do not fit a float64.
        times = (stamps_ns - self._stamps_ns[0]).astype(np.float64)
        known = (self._stamps_ns - self._stamps_ns[0]).astype(np.float64)
        values = self._unwrapped()
        lat, lon = (np.interp(times, known[self._when], values[self._where, column]) for column in (0, 1))
        alt, heading, speed, sigma = (np.interp(times, known, values[:, column]) for column in (2, 3, 4, 5))
        columns = np.column_stack([lat, lon, alt, np.degrees(heading) % 360.0, speed, sigma])
        after = np.searchsorted(known, times).clip(0, len(known) - 1)
        sources = [
            worse_source(*(POSITION_SOURCES[self._sources[index]] for index in pair))
            for pair in zip((after - 1).clip(0), after, strict=True)
        ]
        return [
            TrackFix(int(stamp), lat_deg, lon_deg, alt_m, heading_deg, speed_mps, sigma_m, source)
            for stamp, (lat_deg, lon_deg, alt_m, heading_deg, speed_mps, sigma_m), source in zip(
                stamps_ns, columns.tolist(), sources, strict=True
            )
        ]

    def _unwrapped(self) -> Floats:
        """The values with headings in radians that do not jump from 360 to 0."""
        values = self._values.copy()
        heading_known = np.isfinite(values[:, 3])
        values[heading_known, 3] = np.unwrap(np.radians(values[heading_known, 3]))
        return values

    def rows(self, pictures: str, files: Sequence[str], stamps_ns: Sequence[int]) -> tuple[FeedRow, ...]:
        """A feed's row for each picture; None for what is not known at its time.

        pictures: their name in the message. FeedError if none of them was taken while there were positions.
        """
        times = np.array(stamps_ns, dtype=np.int64)
        covered = self.covers(times)
        if not covered.any():
            raise FeedError(
                f"{pictures}: taken from {_seconds(times.min())} to {_seconds(times.max())} s, where {self._source} has"
                f" no positions (its first is of {_seconds(self._stamps_ns[0])}, its last of"
                f" {_seconds(self._stamps_ns[-1])} s)"
            )
        fixes = self.at(times)
        return tuple(
            row_at(file, fix) if known else FeedRow(file, fix.stamp_ns)
            for file, fix, known in zip(files, fixes, covered, strict=True)
        )


def _without_jumps(source: str, fixes: list[TrackFix]) -> list[TrackFix]:
    """Those whose times agree with their neighbors'. FeedError where that leaves more than a day."""
    stamps_ns = np.array([min(max(fix.stamp_ns, -FARTHEST_NS), FARTHEST_NS) for fix in fixes], dtype=np.int64)
    kept = np.ones(len(fixes), dtype=bool)
    if (np.diff(stamps_ns) < -SWAPPED_S * 1e9).any():
        kept = _in_order(stamps_ns)
        if (~kept).sum() > MOST_JUMPS * len(fixes):
            kept[:] = True
    # A clock that was set late, or one wrong time at the end: the times grow, by years.
    ordered = np.flatnonzero(kept)[np.argsort(stamps_ns[kept], kind="stable")]
    parts = np.split(ordered, np.flatnonzero(np.diff(stamps_ns[ordered]) > LONGEST_S * 1e9) + 1)
    longest = max(parts, key=len)
    if len(longest) >= (1 - MOST_JUMPS) * len(fixes):
        kept[:] = False
        kept[longest] = True
    if not kept.any():
        return fixes
    if np.abs(stamps_ns[kept]).max() == FARTHEST_NS:
        raise FeedError(f"{source}: its positions are of a year that no clock of a drive has; correct their times")
    first_ns, last_ns = int(stamps_ns[kept].min()), int(stamps_ns[kept].max())
    if last_ns - first_ns > LONGEST_S * 1e9:
        raise FeedError(
            f"{source}: its positions are from {_utc(first_ns)} to {_utc(last_ns)} UTC, and one drive is a day at"
            " most; split it, or remove the positions with a wrong time"
        )
    if not kept.all():
        wrong = [_utc(int(stamp_ns)) for stamp_ns in stamps_ns[~kept][:3]]
        more = ", ..." if len(fixes) - kept.sum() > len(wrong) else ""
        words = "%s: %d of %d positions are dropped, whose times jump against those beside them: %s UTC"
        log.warning(words, source, len(fixes) - kept.sum(), len(fixes), ", ".join(wrong) + more)
    return [fix for fix, is_kept in zip(fixes, kept, strict=True) if is_kept]


def _in_order(stamps_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which stamps are of the longest series that never goes back, or hardly off it (Schensted 1961)."""
    ends, rows = list[int](), list[int]()  # the smallest stamp in which a series of each length ends, and its row
    before = [-1] * len(stamps_ns)
    for row, stamp_ns in enumerate(stamps_ns.tolist()):
        length = bisect_right(ends, stamp_ns)
        before[row] = rows[length - 1] if length else -1
        ends[length : length + 1], rows[length : length + 1] = [stamp_ns], [row]
    series = np.zeros(len(stamps_ns), dtype=bool)
    row = rows[-1]
    while row >= 0:
        series[row], row = True, before[row]
    low = np.maximum.accumulate(np.where(series, stamps_ns, stamps_ns[series][0]))
    high = np.minimum.accumulate(np.where(series, stamps_ns, stamps_ns[series][-1])[::-1])[::-1]
    swapped_ns = round(SWAPPED_S * 1e9)
    return series | ((stamps_ns >= low - swapped_ns) & (stamps_ns <= high + swapped_ns))


def _utc(stamp_ns: int) -> str:
    """Also of a time that no calendar has."""
    try:
        return f"{datetime(1970, 1, 1, tzinfo=timezone.utc) + timedelta(seconds=stamp_ns / 1e9):%Y-%m-%d %H:%M:%S}"
    except OverflowError:
        return f"{stamp_ns / 1e9:.0f} s since 1970"


def _without_wandering(
    stamps_ns: NDArray[np.int64], lat_deg: Floats, lon_deg: Floats
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """The fixes whose stamps count, and for each the fix that says where the vehicle was then."""
    meters, stamps = east_north(lat_deg, lon_deg).tolist(), stamps_ns.tolist()
    when, where = [0], [0]
    for index, place in enumerate(meters):
        stood = stamps[index] - stamps[when[-1]] > STANDING_S * 1e9
        if math.dist(place, meters[where[-1]]) >= STANDING_M:
            if stood and index - 1 > when[-1]:
                when.append(index - 1)
                where.append(where[-1])
            when.append(index)
            where.append(index)
        elif index == len(meters) - 1 and index > when[-1]:
            when.append(index)
            where.append(where[-1] if stood else index)
    return np.array(when), np.array(where)


def from_local(x_m: float, y_m: float, zone: str = "") -> tuple[float, float]:
    """Latitude and longitude of meters east and north: of a UTM zone ("56J"), else of an origin of their own.

    That becomes 0, 0: as degrees, all that measures and draws tracks reads them. They are of the source "local".
    """
    to_degrees = _projection(zone)
    lon_deg, lat_deg = to_degrees.transform(x_m, y_m, direction="INVERSE")
    return float(lat_deg), float(lon_deg)


@cache
def _projection(zone: str) -> Transformer:
    matched = re.fullmatch(r"(\d{1,2})([C-Xc-x]?)", zone.strip())
    if not matched:
        return Transformer.from_pipeline("+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad" + LOCAL)
    south = " +south" if matched[2] and matched[2].upper() < "N" else ""
    utm = f" +step +proj=utm +zone={int(matched[1])}{south} +ellps=WGS84"
    return Transformer.from_pipeline("+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad" + utm)


def row_at(file: str, fix: TrackFix) -> FeedRow:
    """A feed's row for the picture taken at a fix."""
    known = [None if math.isnan(value) else value for value in astuple(fix)[1:-1]]
    lat_deg, lon_deg, alt_m, heading_deg, speed_mps, sigma_m = known
    at = lat_deg, lon_deg, alt_m, heading_deg, speed_mps
    return FeedRow(file, fix.stamp_ns, *at, position_sigma_m=sigma_m, position_source=fix.source)


def _seconds(stamp_ns: np.int64) -> str:
    return f"{int(stamp_ns) / 1e9:.3f}"
