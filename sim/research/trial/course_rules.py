"""Rules of single courses: what they send, what the pilot reads, and when GPS is called wrong."""

from __future__ import annotations

import math

import numpy as np

from sim.trial.rules import AGAIN_M, Run, lost_s

SENT_SHARE = 0.4
FAILSAFE_S = 6.0
WARNING, WARNED_S = 4, 30.0
CALLED_M, USUAL_M = 50.0, 10.0
UNRECOGNIZED = "not recognized where GPS"


def close(run: Run) -> str:
    """After a position the autopilot is right within 3 m (median) and 6 m (95 %), and on its lane within 5 m (95 %)."""
    if not len(run.after_m):
        return "no position used"
    lane_m = np.percentile(np.abs(run.track.left_m), 95)
    found = np.median(run.after_m), np.percentile(run.after_m, 95), lane_m
    names = ("median after", "95 % after", "cross-track")
    return next((f"{n} {v:.1f} m" for n, v, most in zip(names, found, (3, 6, 5), strict=True) if v > most), "")


def sends(run: Run) -> str:
    """Positions are sent for a good share of the time in which they may be expected."""
    return f"share sent {run.share_sent:.2f}" if run.share_sent < SENT_SHARE else ""


def never_sent(run: Run) -> str:
    """No position is sent."""
    return f"{len(run.sent.time_s)} sent" if len(run.sent.time_s) else ""


def not_with_gps(run: Run) -> str:
    """No position arrives once GPS has been back for 2 s."""
    lost_s = run.track.time_s[~run.track.gps]
    late = int((run.sent.time_s > lost_s[-1] + 2.0).sum()) if len(lost_s) else len(run.sent.time_s)
    return f"{late} sent with GPS" if late else ""


def sources_restored(run: Run) -> str:
    """Positions are used, and with GPS the filter ends on its first set of sources."""
    if not len(run.after_m):
        return "no position used"
    return f"ends on source set {run.source_set}" if run.source_set != 1 else ""


def warns(run: Run) -> str:
    """Within 30 s of the first position, a warning about positions says that the autopilot does not follow."""
    if not len(run.sent.time_s):
        return "no position sent"
    first_s = run.sent.time_s[0]
    warned = [
        text
        for time_s, severity, text in run.texts
        if severity <= WARNING and first_s <= time_s <= first_s + WARNED_S and "position" in text.lower()
    ]
    return "" if warned else "no warning"


def warns_of_another(run: Run) -> str:
    """Within 30 s of the start, a warning says that another autopilot has the same ids."""
    warned = (severity <= WARNING and "autopilot" in text for at_s, severity, text in run.texts if at_s <= WARNED_S)
    return "" if any(warned) else "no warning"


def first_in_time(run: Run) -> str:
    """The first position comes within 6 s of the loss of GPS."""
    gps_lost_s = lost_s(run)
    first_s = min((time_s for time_s in run.sent.time_s if time_s >= gps_lost_s), default=math.inf) - gps_lost_s
    return f"first after {first_s:.1f} s" if first_s > FAILSAFE_S else ""


def called_before_50_m(run: Run) -> str:
    """GPS is called wrong before the autopilot, which follows it, is 50 m wrong."""
    called_s = _called_s(run)
    worst_m = run.track.error_m[run.track.time_s <= called_s].max()
    return f"{worst_m:.0f} m before a call" if worst_m >= CALLED_M else ""


def called_soon(run: Run) -> str:
    """GPS is called wrong within 200 m of the moment at which the autopilot is 20 m wrong."""
    wrong = np.flatnonzero(run.track.error_m > CALLED_M * 0.4)
    if not len(wrong):
        return ""
    until = np.searchsorted(run.track.time_s, _called_s(run)).clip(0, len(run.track.time_s) - 1)
    driven_m = abs(run.track.along_m[until] - run.track.along_m[wrong[0]])
    return f"not called for {driven_m:.0f} m" if driven_m > AGAIN_M else ""


def called_on_map(run: Run) -> str:
    """Once GPS is wrong, it is called so by the end of the drive."""
    return "not called" if math.isinf(_called_s(run)) else ""


def never_called(run: Run) -> str:
    """GPS is not called wrong, nor the vehicle said to be unrecognized where GPS has it."""
    for what, at_s in (("called", _called_s(run)), ("warned", _called_s(run, UNRECOGNIZED))):
        if not math.isinf(at_s):
            return f"{what} at {at_s:.0f} s"
    return ""


def warned_before_50_m(run: Run) -> str:
    """GPS is called wrong, or the pilot warned, before the autopilot, which steers by it, is 50 m wrong."""
    warned_s = min(_called_s(run), _called_s(run, UNRECOGNIZED))
    worst_m = run.track.error_m[run.track.time_s <= warned_s].max()
    return "no warning" if math.isinf(warned_s) else f"{worst_m:.0f} m before it" if worst_m >= CALLED_M else ""


def back_to_usual(run: Run) -> str:
    """From 200 m after the call on, the autopilot's error is at most 10 m (95 %)."""
    track, called_s = run.track, _called_s(run)
    if math.isinf(called_s):
        return ""
    at_m = np.interp(called_s, track.time_s, track.along_m)
    errors_m = track.error_m[(track.time_s > called_s) & (track.along_m > at_m + AGAIN_M)]
    if not len(errors_m):
        return ""
    error_m = np.percentile(errors_m, 95)
    return f"error {error_m:.0f} m after the call" if error_m > USUAL_M else ""


def _called_s(run: Run, text: str = "GPS is wrong") -> float:
    return min((time_s for time_s, severity, one in run.texts if text in one and severity <= WARNING), default=math.inf)
