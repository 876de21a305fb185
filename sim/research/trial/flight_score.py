"""What a drive's positions were worth, by the truth: of those that were recorded, and of those that are sent now."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import msgspec
import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.journal.records import FixSent, FrameUsed
from edge.telemetry.codec import Message
from edge.telemetry.encoders import EXTERNAL_POSITION_ESTIMATE
from sim.research.trial.recorded_drive import RecordedDrive
from sim.trial.records import Array
from sim.trial.run import read_position
from sim.vehicle.position_inputs import east_north_m

Key: TypeAlias = tuple[int, int] | int
"""By which a position that was sent is found in the journal: its degrees times 1e7, or of a fused pose when, in ms."""
VISION = mavlink.MAVLINK_MSG_ID_VISION_POSITION_ESTIMATE
MOVES_M = 1.0
"""By so much a reset moves the autopilot at least where it counts as nearer to the truth or further from it."""
FALSE_M = 25.0
"""Of a believed place from the truth: the lines end up to 20 m off where a stretch begins."""


RESET_M = 0.15
"""Between two of the autopilot's positions, 0.1 s apart, from what its velocity says: more is a reset. Without Lookback
(ardupilot_off911) no step is so large."""


class SentPosition(msgspec.Struct, frozen=True):
    """A position that was sent: how far from the truth, ahead and to the right.

    message: the number of the command or message, 0 of one that was not sent. time_s: since GPS was lost, driven_m:
    since then. sigma_m, levels, sigma_along_m: as in the journal, None where it has none for this one (of a
    stream it has one a second). own_m, moves_m: how far the autopilot was from the truth at the moment of a reset, and
    from the reset; None of a stream. by_pose: whether a keypoint pose says it.
    Errors are NaN where nothing says where the vehicle was.
    """

    time_s: float
    driven_m: float
    message: int
    error_m: float
    along_m: float
    cross_track_m: float
    sigma_m: float | None = None
    level_along_m: float | None = None
    level_cross_track_m: float | None = None
    sigma_along_m: float | None = None
    own_m: float | None = None
    moves_m: float | None = None
    by_pose: bool = False

    @property
    def is_fused(self) -> bool:
        """Whether it is a keypoint pose that the autopilot fuses as a measurement; of a stream the journal has some."""
        return self.message == VISION or (self.by_pose and self.message != EXTERNAL_POSITION_ESTIMATE)

    @property
    def is_further(self) -> bool | None:
        """Whether this reset is further from the truth than the autopilot was; None where it moves it too little."""
        if self.own_m is None or self.moves_m is None or self.moves_m < MOVES_M or math.isnan(self.error_m):
            return None
        return self.error_m > self.own_m

    @property
    def sigmas(self) -> float:
        """Error over standard deviation; NaN where that is not known."""
        if not self.sigma_m:
            return math.nan
        return self.error_m / self.sigma_m


class Text(msgspec.Struct, frozen=True):
    """A line that the pilot read; time_s: since GPS was lost."""

    time_s: float
    text: str


class Score(msgspec.Struct, frozen=True):
    """One drive, as recorded or now. silent_s: the longest time without a position, from the loss of GPS to the end.

    used, believed, false_places: frames, see FALSE_M.
    """

    positions: list[SentPosition]
    silent_s: float
    used: int
    believed: int
    false_places: int
    texts: list[Text]

    def row(self) -> dict[str, float]:
        """The figures of the table; NaN where there is nothing to measure."""
        error_m = np.array([one.error_m for one in self.positions if not math.isnan(one.error_m)])
        sigmas = np.array([one.sigmas for one in self.positions])
        sigmas = sigmas[~np.isnan(sigmas)]
        median_m, most_m, largest_m = np.percentile(error_m, [50, 95, 100]) if len(error_m) else [math.nan] * 3
        bounded = [one for one in self.positions if one.level_along_m and one.level_cross_track_m]
        poses, sequences = ([one for one in self.positions if one.by_pose is by_pose] for by_pose in (True, False))
        return {
            "sent": len(self.positions),
            "fused": sum(one.is_fused for one in self.positions),
            "median_m": median_m,
            "p95_m": most_m,
            "max_m": largest_m,
            "sigmas_rms": math.sqrt(np.mean(sigmas**2)) if len(sigmas) else math.nan,
            "sigmas_max": sigmas.max() if len(sigmas) else math.nan,
            "known": len(sigmas),
            "beyond_3": int((sigmas > 3).sum()),
            "beyond_4": int((sigmas > 4).sum()),
            "levels": len(bounded),
            "over_along": sum(abs(one.along_m) > (one.level_along_m or 0.0) for one in bounded),
            "over_cross_track": sum(abs(one.cross_track_m) > (one.level_cross_track_m or 0.0) for one in bounded),
            **{
                f"{way}_by_{kind}": sum(one.is_further is is_further for one in resets)
                for kind, resets in (("poses", poses), ("sequences", sequences))
                for way, is_further in (("nearer", False), ("further", True))
            },
            "first_m": next((one.driven_m for one in self.positions if one.time_s >= 0), math.nan),
            "silent_s": self.silent_s,
            "used": self.used,
            "believed": self.believed,
            "false": self.false_places,
        }


def score(
    drive: RecordedDrive,
    messages: Sequence[tuple[float, Message]],
    sent: Sequence[FixSent],
    used: Sequence[FrameUsed],
) -> Score:
    """Score what the daemon sent; sent, used: by its journal."""
    lost_s, (_, stops_s) = drive.gps_lost_s, drive.moves_s
    known: dict[Key, FixSent] = {(round(one.lat_deg * 1e7), round(one.lon_deg * 1e7)): one for one in sent}
    known |= {round(one.send_boot_s * 1e3): one for one in sent if one.way == "vision_position"}
    positions = [one for at_s, message in messages if (one := _position(drive, at_s, message, known)) is not None]
    moments_s = [0.0, *(one.time_s for one in positions if one.time_s >= 0), stops_s - lost_s]
    texts = [
        Text(round(at_s - lost_s, 2), message.text) for at_s, message in messages if message.get_type() == "STATUSTEXT"
    ]
    believed = [one for one in used if one.accepted and one.lat_deg is not None and one.lon_deg is not None]
    off_m = [
        math.dist(east_north_m(one.lat_deg or 0.0, one.lon_deg or 0.0), drive.true_m(one.stamp_ns / 1e9).tolist())
        for one in believed
    ]
    silent_s = round(float(np.diff(moments_s).max()), 2)
    return Score(positions, silent_s, len(used), len(off_m), sum(off > FALSE_M for off in off_m), texts)


def _position(
    drive: RecordedDrive, sent_s: float, message: Message, known: Mapping[Key, FixSent]
) -> SentPosition | None:
    position = read_position(message, drive.origin_deg)
    if position is None:
        return None
    *here_m, _, age_s = position
    of_s, said = sent_s - age_s, dict[str, Any]()
    if message.get_type() == "COMMAND_INT":
        fix, number, own_m = known.get((message.x, message.y)), message.command, drive.own_m(of_s).tolist()
        said["own_m"] = round(off_truth(drive, own_m, of_s)[0], 3)
        said["moves_m"] = round(math.dist(here_m, own_m), 3)
    else:
        number = message.get_msgId()
        key: Key = round(message.usec / 1e3) if number == VISION else (message.lat, message.lon)
        fix = known.get(key)
    if fix is not None:
        names = "sigma_m", "level_along_m", "level_cross_track_m"
        said |= {**{name: getattr(fix, name) for name in names}, "sigma_along_m": fix.sigma_along_m or None}
        said["by_pose"] = bool(fix.points)
    error_m, along_m, cross_track_m = (round(one, 3) for one in off_truth(drive, here_m, of_s))
    driven_m = round(drive.driven_m(sent_s) - drive.driven_m(drive.gps_lost_s), 2)
    since_s = round(sent_s - drive.gps_lost_s, 3)
    return SentPosition(since_s, driven_m, number, error_m, along_m, cross_track_m, **said)


def off_truth(drive: RecordedDrive, here_m: Sequence[float], time_s: float) -> tuple[float, float, float]:
    """How far a position, meters (2,) east and north, is from the truth: in all, ahead, and to the right."""
    off_m, heading_rad = np.array(here_m) - drive.true_m(time_s), math.radians(drive.heading_deg(time_s))
    ahead = np.array([math.sin(heading_rad), math.cos(heading_rad)])
    return math.hypot(*off_m), float(off_m @ ahead), float(off_m @ [ahead[1], -ahead[0]])


def autopilot_errors(drive: RecordedDrive) -> Array:
    """Meters by which the autopilot's own position was off (n,), from the loss of GPS on, as recorded."""
    own, (_, stops_s) = drive.own, drive.moves_s
    after = (own["mono_s"] >= drive.gps_lost_s) & (own["mono_s"] <= stops_s)
    off_m = np.stack([own["east_m"], own["north_m"]])[:, after] - drive.true_m(own["mono_s"][after])
    return np.asarray(np.hypot(*off_m))


def dead_reckoning_errors(drive: RecordedDrive) -> Array:
    """Meters by which the autopilot's position would be off without positions of ours (n,), from the loss of GPS on.

    Its own as recorded, with its velocity in place of each step that a position of ours made. That is more than it
    would have been, since after a reset a filter does not correct the position for the heading error that its compass
    finds. None where GPS was not lost on the way.
    """
    own, (sets_off_s, stops_s) = drive.own, drive.moves_s
    after = (own["mono_s"] >= drive.gps_lost_s) & (own["mono_s"] <= stops_s)
    if drive.gps_lost_s == sets_off_s or not after.any():
        return np.empty(0)
    time_s = own["mono_s"][after]
    here_m, velocity_mps = (
        np.stack([own[f"east_{unit}"], own[f"north_{unit}"]], axis=1)[after] for unit in ("m", "mps")
    )
    steps_m = np.diff(here_m, axis=0)
    driven_m = (velocity_mps[1:] + velocity_mps[:-1]) / 2 * np.diff(time_s)[:, None]
    is_stream = any(one.message.get_type() == "GLOBAL_POSITION_SENSOR" for one in drive.link)
    is_ours = is_stream | (np.hypot(*(steps_m - driven_m).T) > RESET_M)
    reckoned_m = here_m[0] + np.cumsum(np.where(is_ours[:, None], driven_m, steps_m), axis=0)
    return np.asarray(np.hypot(*(reckoned_m.T - drive.true_m(time_s[1:]))))


def lane_errors(drive: RecordedDrive) -> Array:
    """Meters by which the vehicle was beside its lane (n,), from the loss of GPS on, as recorded."""
    moments_s = np.arange(drive.gps_lost_s, drive.moves_s[1], 0.2)
    starts, legs = drive.lane_m[:-1], np.diff(drive.lane_m, axis=0)
    off_m: Array = drive.true_m(moments_s).T[:, None] - starts
    share = np.clip((off_m * legs).sum(axis=2) / np.maximum((legs**2).sum(axis=1), 1e-9), 0.0, 1.0)
    return np.asarray(np.hypot(*np.moveaxis(off_m - share[..., None] * legs, 2, 0)).min(axis=1))
