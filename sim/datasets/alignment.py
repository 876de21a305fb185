"""When a video began on the clock of a track: by the time in its container, and by what both of them show.

Pictures turn as the vehicle turns, and flow past as fast as it drives, whichever way the camera looks; a track says
both. Their correlation over all possible starts is a likelihood, and the creation time says how likely each start is
before anything was measured; without one, that the two are equally long. Phones with Android write the time at which a
recording ended, most other cameras that at which it began, and some their local time as if it were UTC.
docs/recordings.md has the errors of 20 simulated videos.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.errors import FeedError
from edge.feed import FeedRow, Pictures
from edge.geodesy import east_north
from sim.datasets.track import Track

Floats = NDArray[np.float64]

STEP_S = 0.1
ALIGNED_S = 600.0
"""Of a longer video only the beginning is used: 10 minutes have turns and stops enough."""
WIDTH_PX = 160
"""Of the pictures in which motion is measured: 4 ms a picture, and turns correlate by 0.99 with the vehicle's own."""
MOVING_MPS = 1.0
"""Below, the course of a track is that of its noise."""
SMOOTHED_S = {"picture": 1.0, "track": 0.6}
"""The triangle that motion is smoothed by; a track of one position a second is smooth already."""
LASTS_S = {"turn": 4.0, "speed": 8.0}
"""How long the motion stays alike: so much of a video counts as one measurement. With these, starts were 0.9 of their
sigma off (rms of 20 videos), with half of them 1.4 (11 videos)."""
LEAST = 7.0
"""Log-likelihood above that of motion that has nothing in common, from which motion is believed alone, see LASTS_S: one
video of a hundred was laid over the track of another drive."""
SURE = 0.95
"""Probability that the start lies within NEAR_S of the likeliest one, from which it is known."""
NEAR_S = 3.0
LEAST_SIGMA_S = 0.1
"""Of a start: exposure, the receiver's own delay, and whole frames."""
LEVER_M, LEVERS_M = 3.0, np.arange(-9.0, 9.5, 1.0)
"""A camera turns as the antenna's track does so far on: a vehicle turns about the axle that does not steer, and how far
ahead of it the antenna is, is not known. One standard deviation, and what is tried; the speed, which both have at the
same time, decides as far as it can."""
CLOCK_S = 1.0
"""One standard deviation of a creation time: it has whole seconds, and a clock that is set by a network."""
AS_LONG_S = 1.5
"""By less than this, a track of one position a second and a video that were cut together differ: both begin at once."""
DRIFT_S = 120.0
"""By so much clocks that nobody sets differ (of action cameras), in one of ten."""
ZONE_S, ZONES = 900.0, 56
"""Time zones differ by multiples of this, 14 hours at most; one camera of fifty writes its local time as UTC."""


@dataclass(frozen=True)
class MotionSignal:
    """Turning to the right and speed, each in a unit of its own, at each STEP_S from `start_s` on; NaN: not known."""

    start_s: float
    turn: Floats
    speed: Floats


@dataclass(frozen=True)
class Alignment:
    """Where a video lies on a track. start_ns: of its first frame, on the track's clock; sigma_s: of that, None where
    somebody said it. how: in words. Others, for the plot: motion of both, starts that were tried (seconds from the
    track's first position), and how likely each is (log, 0 at best).
    """

    start_ns: int
    sigma_s: float | None
    how: str
    offset_s: float = 0.0
    pictures: MotionSignal | None = None
    track: MotionSignal | None = None
    tried_s: Floats | None = None
    likelihood: Floats | None = None


@dataclass(frozen=True)
class CreationTime:
    """What a container says of when it was made, in s since 1970. is_start: whether the recording began then, None
    where that is not known. duration_s: of the video.
    """

    unix_s: float
    is_start: bool | None
    duration_s: float


def creation_time(file: Path, duration_s: float) -> CreationTime | None:
    """That of a video; None where there is none, or the package av cannot read it."""
    import av

    try:
        with av.open(str(file)) as container:
            said = dict(container.metadata)
    except av.FFmpegError:
        return None
    text = said.get("com.apple.quicktime.creationdate", "")  # with its zone, when the recording began
    is_start = True if text else False if "com.android.version" in said else None
    text = text or said.get("creation_time", "").partition(";")[0]  # of a copy it may be there twice
    text = re.sub(r"([+-]\d\d)(\d\d)$", r"\1:\2", text.replace("Z", "+00:00"))
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        return None
    unix_s = moment.replace(tzinfo=moment.tzinfo or timezone.utc).timestamp()
    return CreationTime(unix_s, is_start, duration_s) if unix_s > 86_400 else None  # a clock that was never set


def align(name: str, rows: Sequence[FeedRow], pictures: Pictures, track: Track, made: CreationTime | None) -> Alignment:
    """When the first of `rows` was taken, on the clock of the track. FeedError where that cannot be known.

    rows: of a video, stamped from its first frame. name: of the video, for the message.
    """
    first_ns = track.fixes[0].stamp_ns
    seen, driven = picture_motion(rows, pictures), track_motion(track)
    tried_s, likelihood = likelihoods(seen, driven)
    # Of the first frame, in seconds from the track's first position.
    tried_s = tried_s - seen.start_s
    made_s = None if made is None else made.unix_s - first_ns / 1e9
    lasts_s = (rows[-1].stamp_ns - rows[0].stamp_ns) / 1e9
    is_as_long = made is None and abs((track.fixes[-1].stamp_ns - first_ns) / 1e9 - lasts_s) < AS_LONG_S
    prior, near_clock = _prior(tried_s, made, 0.0 if is_as_long else made_s)
    found = likelihood + prior
    if not np.isfinite(found).any():
        raise FeedError(f"{name}: {_no_common_time(track, made)}")
    best = int(np.argmax(found))
    share = np.exp(found - found[best])
    near = np.abs(tried_s - tried_s[best]) < NEAR_S
    sure = share[near].sum() / share.sum()
    weights = share[near] / share[near].sum()
    offset_s = round(float(weights @ tried_s[near]), 3) + 0.0  # not -0.0
    sigma_s = math.hypot(math.sqrt(weights @ (tried_s[near] - offset_s) ** 2), LEAST_SIGMA_S)
    by_motion = bool(likelihood[best] >= LEAST)
    if sure < SURE or not (by_motion or near_clock[best]):
        clock = "it has no creation time" if made is None else "its creation time alone does not say"
        raise FeedError(
            f"{name}: where it lies on its track is not known: {clock}, and its pictures do not turn and stop as the"
            " track does; give the seconds from the track's first position to the video's first frame: --offset-s (of"
            " `try`: --reference-offset-s, --query-offset-s)"
        )
    how = _how(made_s, offset_s, made, by_motion=by_motion, by_clock=bool(near_clock[best]))
    words = f"the video began {offset_s:.1f} s after the track's first position, known to {sigma_s:.1f} s, {how}"
    start_ns = first_ns + round(offset_s * 1e9)
    return Alignment(start_ns, sigma_s, words, offset_s, seen, driven, tried_s, found - found[best])


def picture_motion(rows: Sequence[FeedRow], pictures: Pictures) -> MotionSignal:
    """By optical flow between pictures STEP_S apart: of the upper half for turns, and how uneven it is for speed."""
    flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_FAST)
    before: tuple[NDArray[np.uint8], float] | None = None
    found: list[tuple[float, float, float]] = []
    for index, row in enumerate(rows):
        at_s = (row.stamp_ns - rows[0].stamp_ns) / 1e9
        if at_s > ALIGNED_S:
            break
        if before is not None and at_s - before[1] < 0.9 * STEP_S:
            continue
        image = pictures.read(index)
        size = WIDTH_PX, max(16, round(image.shape[0] * WIDTH_PX / image.shape[1]))
        gray = cv2.cvtColor(cv2.resize(image, size, interpolation=cv2.INTER_AREA), cv2.COLOR_BGR2GRAY)
        if before is not None:
            moved = np.asarray(flow.calc(before[0], gray, np.zeros((*gray.shape, 2), np.float32)), dtype=np.float64)
            uneven = moved - np.median(moved, axis=(0, 1))
            took_s = at_s - before[1]
            turn = -float(np.median(moved[: size[1] // 2, :, 0])) / took_s
            found.append(((at_s + before[1]) / 2, turn, math.log(0.5 + np.hypot(*uneven.T).mean() / took_s)))
        before = np.asarray(gray, dtype=np.uint8), at_s
    if len(found) < 2:
        return MotionSignal(0.0, np.zeros(1), np.zeros(1))
    return _motion(np.array(found), "picture")


def track_motion(track: Track) -> MotionSignal:
    """Of one position a second, however many there are: differences of more would be those of their noise."""
    stamps_ns = np.array([fix.stamp_ns for fix in track.fixes])
    known_s = (stamps_ns - stamps_ns[0]) / 1e9
    at_s = np.arange(0.0, known_s[-1], min(1.0, max(known_s[-1] / 2, STEP_S)))
    degrees = [np.interp(at_s, known_s, [getattr(fix, name) for fix in track.fixes]) for name in ("lat_deg", "lon_deg")]
    steps_m, steps_s = np.diff(east_north(*degrees), axis=0), np.diff(at_s)
    speed, middle_s = np.hypot(*steps_m.T) / steps_s, at_s[:-1] + steps_s / 2
    moving = speed > MOVING_MPS
    turn = np.zeros(len(speed))
    if moving.sum() > 2:
        course = np.unwrap(np.arctan2(steps_m[moving, 0], steps_m[moving, 1]))
        turn = np.where(moving, np.gradient(np.interp(middle_s, middle_s[moving], course), middle_s), 0.0)
    motion = _motion(np.column_stack([middle_s, turn, np.log1p(speed)]), "track")
    at_s = motion.start_s + STEP_S * np.arange(len(motion.turn))
    unknown = ~track.covers(stamps_ns[0] + (at_s * 1e9).astype(np.int64))
    return MotionSignal(motion.start_s, *(np.where(unknown, np.nan, line) for line in (motion.turn, motion.speed)))


def _motion(measured: Floats, smoothed: str) -> MotionSignal:
    """Of times, turns and speeds (N, 3)."""
    at_s = np.arange(measured[0, 0], measured[-1, 0] + STEP_S / 2, STEP_S)
    box = np.ones(max(1, round(SMOOTHED_S[smoothed] / STEP_S)))
    triangle = np.convolve(box, box) / box.sum() ** 2
    around = len(box) - 1
    turn, speed = (
        np.convolve(np.pad(np.interp(at_s, measured[:, 0], line), around, mode="edge"), triangle, "valid")
        for line in measured.T[1:]
    )
    return MotionSignal(float(at_s[0]), turn, speed)


def likelihoods(seen: MotionSignal, driven: MotionSignal) -> tuple[Floats, Floats]:
    """Starts of `seen` in the time of `driven`, and the log-likelihood of each, 0 for motion with nothing in common.

    Only those at which at least half of the shorter one lies on the other.
    """
    count = len(seen.turn)
    lags = np.arange(-count + 1, len(driven.turn))
    shared, speed = _likelihoods(seen.speed, driven.speed, LASTS_S["speed"])
    share = np.exp(-0.5 * (LEVERS_M / LEVER_M) ** 2)
    turns = [_likelihoods(seen.turn, turn, LASTS_S["turn"])[1] for turn in _turns_ahead(driven, LEVERS_M)]
    total = speed + np.logaddexp.reduce(np.array(turns) + np.log(share / share.sum())[:, None])
    allowed = shared >= min(count, len(driven.turn)) / 2
    return np.asarray(driven.start_s + lags[allowed] * STEP_S, dtype=np.float64), total[allowed]


def _turns_ahead(driven: MotionSignal, levers_m: Floats) -> Iterator[Floats]:
    """The turning of a track so far on along itself, at each of its times."""
    known = np.isfinite(driven.turn) & np.isfinite(driven.speed)
    turn, speed_mps = (np.where(known, line, 0.0) for line in (driven.turn, np.expm1(driven.speed)))
    along_m, course = np.cumsum(speed_mps) * STEP_S, np.cumsum(turn) * STEP_S
    for lever_m in levers_m:
        ahead = np.gradient(np.interp(along_m + lever_m, along_m, course), STEP_S)
        yield np.where(known, ahead, np.nan)


def _likelihoods(one: Floats, other: Floats, lasts_s: float) -> tuple[Floats, Floats]:
    """For `one` laid over `other` from each index on: values that they share, and the log-likelihood."""
    shared, r = _correlations(one, other)
    independent = shared * STEP_S / lasts_s
    return shared, -np.sign(r) * independent / 2 * np.log1p(-(np.clip(r, -0.99, 0.99) ** 2))


def _correlations(one: Floats, other: Floats) -> tuple[Floats, Floats]:
    """For `one` laid over `other` from each index on, also before it: how many values they share, and Pearson's r."""
    size = 1 << (len(one) + len(other)).bit_length()

    def slide(left: Floats, right: Floats) -> Floats:
        found = np.fft.irfft(np.conj(np.fft.rfft(left, size)) * np.fft.rfft(right, size), size)
        return np.concatenate([found[size - len(one) + 1 :], found[: len(other)]])

    known = [np.isfinite(line).astype(float) for line in (one, other)]
    # Without their means, so that the sums lose no digits.
    x, y = (
        np.nan_to_num(line - (np.nanmean(line) if has.any() else 0.0))
        for line, has in zip((one, other), known, strict=True)
    )
    shared = np.maximum(slide(known[0], known[1]).round(), 1.0)
    mean_x, mean_y = slide(x, known[1]) / shared, slide(known[0], y) / shared
    spread = (slide(x * x, known[1]) / shared - mean_x**2) * (slide(known[0], y * y) / shared - mean_y**2)
    together = slide(x, y) / shared - mean_x * mean_y
    least = 1e-9 * max(x.var() * y.var(), 1e-12)
    return shared, np.where(spread > least, together / np.sqrt(np.maximum(spread, least)), 0.0)


def _prior(tried_s: Floats, made: CreationTime | None, made_s: float | None) -> tuple[Floats, NDArray[np.bool_]]:
    """How likely each start is by the creation time (log; -inf: impossible), and which of them it says itself."""
    if made_s is None:
        return np.zeros(len(tried_s)), np.zeros(len(tried_s), dtype=bool)
    starts: tuple[tuple[float, float], ...] = ((made_s, 1.0),)
    if made is not None:
        is_start = 0.8 if made.is_start is None else float(made.is_start)
        starts = (made_s, is_start), (made_s - made.duration_s, 1 - is_start)
    density, near = np.zeros(len(tried_s)), np.zeros(len(tried_s), dtype=bool)
    for start_s, share in starts:
        off_s = tried_s - start_s
        near |= (np.abs(off_s) < NEAR_S) & (share > 0)
        density += share * 0.88 * np.exp(-0.5 * (off_s / CLOCK_S) ** 2) / CLOCK_S
        density += share * 0.1 * (np.abs(off_s) < DRIFT_S) / DRIFT_S
        zones = np.rint(off_s / ZONE_S)
        shifted = (np.abs(zones) <= ZONES) & (np.abs(off_s - zones * ZONE_S) < NEAR_S)
        density += share * 0.02 / (2 * ZONES) * shifted / NEAR_S
    with np.errstate(divide="ignore"):
        return np.log(density), near


def _no_common_time(track: Track, made: CreationTime | None) -> str:
    ends = [datetime.fromtimestamp(track.fixes[index].stamp_ns / 1e9, tz=timezone.utc) for index in (0, -1)]
    if made is None:
        return "too short to be laid over its track; give --offset-s"
    moment = datetime.fromtimestamp(made.unix_s, tz=timezone.utc)
    return (
        f"made at {moment:%Y-%m-%d %H:%M:%S} UTC by its own clock, and its track is of {ends[0]:%Y-%m-%d %H:%M:%S} to"
        f" {ends[1]:%Y-%m-%d %H:%M:%S} UTC: another drive; if the camera's clock was wrong, give --offset-s, the"
        " seconds from the track's first position to the video's first frame"
    )


def _how(made_s: float | None, offset_s: float, made: CreationTime | None, *, by_motion: bool, by_clock: bool) -> str:
    """By what a start is known."""
    if made is None or made_s is None:
        why = "since it is as long as the track and" if by_clock else "by turns and speed alone, since it"
        return f"{why} has no creation time"
    off_s = min((made_s - offset_s, made_s - made.duration_s - offset_s), key=abs)
    if by_clock:
        return f"by its creation time{' and by turns and speed' if by_motion else ' alone'}"
    hours = off_s / 3600
    zone = f", which is {hours:+.2f} h off (a local time?)" if abs(off_s) > DRIFT_S else f", {off_s:+.0f} s off"
    return f"by turns and speed, and not by its creation time{zone}"
