"""What two recordings show together: whether the place is recognized, where not and why, and what to change."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.config import Config
from edge.feed import Feed
from edge.reference_map import MapSet
from edge.sequence.search import FIRST_FRAMES
from sim.calibration.offset import Offset
from sim.evaluation.metrics import precision_recall, recall_at_precision
from sim.evaluation.recognition import Recognition, RecognitionScore
from sim.first_try.with_keypoints import WithKeypoints, assumed_words, why_none
from sim.first_try.with_keypoints import facts as keypoint_facts
from sim.maps.files import LIGHTS
from sim.traverse import driven_m

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

DARK = LIGHTS[0][0]
"""Mean gray level, of 255, below which `lookback map list` calls pictures dark."""
SHORT_FRAMES = 5
"""A stretch of fewer frames is not listed: at 2 m a frame less than 10 m, as after each single frame in doubt."""
GOOD, FAIR = 0.6, 0.2
"""Shares of the judged frames that are believed, for "recognized" and "recognized in part". On the trial's roads 0.7 to
0.95 are believed (docs/evaluation.md); below 0.2 no drive had a position for most of its length."""
TRUSTED = 0.99
"""Precision from which nothing is said of wrong places: that for which `lookback calibrate` sets the threshold."""
MOUNTED_M = 15.0
"""Meters. Cameras that see the same scene match places this near at most (5.9 m simulated, for one mounted 6 m ahead);
cameras that look in opposite directions match places tens of meters ahead."""
ANOTHER_SHAPE = 0.1
"""Share by which the ratio of width to height of the same camera's pictures never differs."""


@dataclass(frozen=True)
class FailureSpan:
    """Frames [first, last] in a row, among the used ones, of which none is believed, or all wrongly; and why."""

    first: int
    last: int
    why: str


@dataclass(frozen=True)
class Verdict:
    """headline: one sentence. advice: what to change or to do next, the most important first."""

    headline: str
    facts: tuple[str, ...]
    stretches: tuple[FailureSpan, ...]
    advice: tuple[str, ...]


@dataclass(frozen=True)
class TryResult:
    """All that is known of a try.

    reference, query: as recorded. judged: None without positions in both. gray: (Q,) mean gray level of each used
    frame's picture. faults: (Q,) what the daemon finds wrong with the picture, "" for nothing. offsets: of the camera,
    empty where not measured, and why. keypoints: None where the map has none.
    """

    reference: Feed
    query: Feed
    maps: MapSet
    config: Config
    seen: Recognition
    judged: RecognitionScore | None
    tolerance_m: float
    gray: Floats
    faults: tuple[str, ...]
    offsets: tuple[Offset, ...] = ()
    why_no_offset: str = "too few places are accepted"
    keypoints: WithKeypoints | None = None

    @property
    def is_on_map(self) -> Flags:
        """(Q,): frames on the mapped road as far as positions say; True where they do not."""
        found = np.ones(len(self.seen.used), dtype=bool)
        if self.judged is not None:
            found[self.judged.rows] = self.judged.answers.has_truth
        return found

    @property
    def is_wrong(self) -> Flags:
        """(Q,): frames that are believed, and positions say that they should not be."""
        found = np.zeros(len(self.seen.used), dtype=bool)
        if self.judged is not None:
            found[self.judged.rows] = self.judged.believed & ~self.judged.answers.correct
        return found

    @property
    def could_be_believed(self) -> Flags:
        """(Q,): frames on the mapped road from the first that is not warming up on."""
        warm: Flags = np.array([state != "warming up" for state in self.seen.states], dtype=bool)
        return np.logical_and(self.is_on_map, np.maximum.accumulate(warm))


def verdict(tried: TryResult) -> Verdict:
    """What follows from all that is known."""
    believed, could = tried.seen.believed, tried.could_be_believed
    share = float(believed[could].mean()) if could.any() else 0.0
    facts = [f"{100 * share:.0f} % of the {int(could.sum())} frames after the start are accepted"]
    if tried.judged is None:
        facts.append("whether they are right is not known: it needs positions in both recordings")
    else:
        facts += _judged_facts(tried.judged, tried.tolerance_m)
        unknown = int(believed.sum() - tried.judged.believed.sum())
        if unknown:
            facts.append(
                f"{unknown} more accepted places are neither right nor wrong: the frame or the place has no position"
            )
    found = ", ".join(
        f"{_ahead(one.ahead_m)} ± {one.ahead_sigma_m:.1f} m ({one.direction}, {one.order})" for one in tried.offsets
    )
    facts.append(
        f"the matched place lies {found}: measured on this query, and used"
        if found
        else f"the camera's offset is not known: {tried.why_no_offset}"
    )
    if tried.keypoints is None:
        facts.append(why_none(tried.reference))
    else:
        facts += keypoint_facts(tried.keypoints, tried.seen)
    stretches = tuple(_stretches(tried))
    return Verdict(_headline(tried, share), tuple(facts), stretches, tuple(_advice(tried, share)))


def _headline(tried: TryResult, share: float) -> str:
    judged = tried.judged
    if judged is not None and judged.believed.any() and judged.precision < TRUSTED:
        wrong = int((judged.believed & ~judged.answers.correct).sum())
        return f"Not to be trusted: {wrong} of {int(judged.believed.sum())} accepted places are wrong"
    if not tried.could_be_believed.any():
        return "Nothing could be recognized"
    recall = float(tried.seen.believed.mean()) if judged is None else judged.recall
    where = "" if tried.is_on_map.all() else " on the mapped road"
    spelled = f"{100 * recall:.0f} % of the frames{where}, {100 * share:.0f} % after the start"
    if recall >= GOOD:
        return f"Recognized: {spelled}"
    return f"Recognized in part: {spelled}" if recall >= FAIR else "Not recognized"


def _judged_facts(judged: RecognitionScore, tolerance_m: float) -> list[str]:
    if not judged.believed.any():
        return ["no place with a position is accepted, so there is no precision"]
    errors_m = judged.error_m[judged.believed]
    surest = recall_at_precision(precision_recall(judged.answers), 1.0)
    believed, on_map = int(judged.believed.sum()), int(judged.answers.has_truth.sum())
    return [
        f"precision {judged.precision:.3f} of {believed} accepted places (within {tolerance_m:g} m)",
        f"recall {judged.recall:.3f} of {on_map} frames on the mapped road, those of the first sequence too;"
        f" {surest:.3f} at the lowest confidence without a wrong place",
        f"error of the accepted places: median {np.median(errors_m):.1f} m, 95 % {np.percentile(errors_m, 95):.1f} m",
    ]


def _ahead(ahead_m: float, digits: int = 1) -> str:
    return f"{abs(ahead_m):.{digits}f} m {'behind' if ahead_m < 0 else 'ahead'}"


def _stretches(tried: TryResult) -> list[FailureSpan]:
    """Where nothing is believed, or wrong places are, in the order of driving."""
    reasons = [_reason(tried, row) for row in range(len(tried.seen.used))]
    starts = [0, *(row for row in range(1, len(reasons)) if reasons[row] != reasons[row - 1])]
    ends = [*starts[1:], len(reasons)]
    runs = [FailureSpan(first, end - 1, reasons[first]) for first, end in zip(starts, ends, strict=True)]
    return [one for one in runs if one.why and one.last - one.first + 1 >= SHORT_FRAMES]


def _reason(tried: TryResult, row: int) -> str:
    """Why a used frame is not believed, "" if it is."""
    if tried.seen.believed[row]:
        return f"accepted, but over {tried.tolerance_m:g} m off" if tried.is_wrong[row] else ""
    state, is_dark = tried.seen.states[row], tried.gray[row] < DARK
    if tried.faults[row]:
        why = tried.faults[row]
    elif state == "warming up":
        why = f"warming up: a place is searched from {FIRST_FRAMES} frames on"
    elif not tried.is_on_map[row]:
        why = f"not on the mapped road: no place of the map within {tried.tolerance_m:g} m"
    elif state == "off the map":
        least = tried.config.acceptance.confidence_from
        why = f"not accepted: confidence below {least:g}{', and the picture is dark' if is_dark else ''}"
    else:
        why = state
    return why


def _advice(tried: TryResult, share: float) -> list[str]:
    """In the order of how much each explains."""
    found = assumed_words(tried.maps, tried.seen) if tried.keypoints is not None else []
    found += _length_advice(tried) if share < GOOD else []
    judged, could = tried.judged, tried.could_be_believed
    for offset in tried.offsets:
        if offset.order == "same" and abs(offset.ahead_m) > MOUNTED_M:
            found.append(
                f"the matched place lies {_ahead(offset.ahead_m, 0)} though both cameras see the same scene: the times"
                f" of videos and tracks differ{_seconds(tried.query, offset.ahead_m)}; set --reference-offset-s and"
                " --query-offset-s"
            )
    if judged is not None:
        opposite = opposite_share(judged)
        same_view = tried.reference.header.view == tried.query.header.view
        if opposite > 0.5 and same_view:
            found.append(
                "the query was driven against the reference, and both cameras look"
                f" {'ahead' if tried.query.header.view == 'front' else 'back'}: a map for the way back needs a camera"
                " that looks the other way (--reference-view rear, if it did)"
            )
        if opposite < 0.5 and not same_view and share < GOOD:
            found.append(
                "both were driven in the same direction with cameras that look in opposite ones; check"
                " --reference-view and --query-view"
            )
        off_share = 1 - float(judged.answers.has_truth.mean())
        if off_share > 0.2:
            found.append(f"{100 * off_share:.0f} % of the query is not on the mapped road: map that road as well")
    else:
        missing = [feed.header.name for feed in (tried.reference, tried.query) if not _is_placed(feed)]
        found.append(
            f"no positions in {' and '.join(missing) or 'the map'}: with a GPX track or a log of the drive, frames are"
            " compared at equal distances whatever the speed, and right can be separated from wrong"
        )
    for feed in (tried.reference, tried.query):
        if feed.header.height > feed.header.width:
            size = f"{feed.header.width} x {feed.header.height}"
            found.append(
                f"the pictures of {feed.header.name} are upright ({size}): both sides of the road are missing; hold"
                " the phone across"
            )
    if share < GOOD:
        found += _picture_advice(tried, could)
        found.append(
            "where it is not recognized, map once more in that light or that lane: `lookback map build` takes several"
            " recordings"
        )
    return found


def _length_advice(tried: TryResult) -> Iterator[str]:
    """Of recordings with few places, and how to get more."""
    enough = 2 * tried.config.sequence_frames
    counted = (tried.reference, tried.maps.index.places), (tried.query, len(tried.seen.used))
    short = {feed.header.name: (count, len(feed.rows)) for feed, count in counted if count < enough}
    if short:
        has = " and ".join(f"{name} has {count} places" for name, (count, _) in short.items())
        more = (
            ", or use more of its frames: --spacing-frames 1"
            if any(rows >= enough for _, rows in short.values())
            else ""
        )
        yield f"{has}, and two sequences are {enough}: record a longer drive{more}"


def _seconds(query: Feed, meters: float) -> str:
    """Meters as seconds of the query's driving, where its speed is known."""
    driven, seconds = driven_m(query), (query.rows[-1].stamp_ns - query.rows[0].stamp_ns) / 1e9
    return f", by {abs(meters) * seconds / driven[-1]:.1f} s together" if driven and driven[-1] > 0 else ""


def _picture_advice(tried: TryResult, could: Flags) -> list[str]:
    found = []
    missed = could & ~tried.seen.believed
    gray = float(np.median(tried.gray[missed])) if missed.any() else DARK
    if gray < DARK:
        found.append(
            f"the pictures that are not recognized are dark (median gray level {gray:.0f} of 255): a longer exposure or"
            " headlights help"
        )
    shapes = [feed.header.width / feed.header.height for feed in (tried.reference, tried.query)]
    if abs(shapes[0] / shapes[1] - 1) > ANOTHER_SHAPE:
        sizes = [f"{feed.header.width} x {feed.header.height}" for feed in (tried.reference, tried.query)]
        found.append(
            f"the pictures are {sizes[0]} and {sizes[1]}: use the same camera, or cut both to the same view with"
            " [camera] crop"
        )
    return found


def opposite_share(judged: RecognitionScore) -> float:
    """Share of the frames on the map that are driven against the nearest place's drive; 0.0 where nothing moves."""
    places_m, truth_m = judged.places_m, judged.truth_m
    if len(places_m) < 2 or len(truth_m) < 2:
        return 0.0
    along, driven = np.gradient(places_m, axis=0), np.gradient(truth_m, axis=0)
    on_map = np.flatnonzero(judged.answers.has_truth)
    nearest = [int(np.hypot(*(places_m - truth_m[row]).T).argmin()) for row in on_map]
    turned = np.einsum("nd,nd->n", along[nearest], driven[on_map])
    return float((turned < 0).mean()) if len(turned) else 0.0


def _is_placed(feed: Feed) -> bool:
    return any(row.lat_deg is not None for row in feed.rows)
