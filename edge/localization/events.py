"""What happens on a drive, and what follows from it: a drive is a list of (t_ns, event). Pure.

Only events change the position estimator (`PositionEstimator.update`), so that the list of one drive, which the daemon
can write (`[telemetry] drive`), gives the same positions and the same refusals again anywhere. What telemetry, a
trial or a bench knows of a vehicle and of GPS is said by one of these, and by nothing else.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias

from msgspec import Struct

from edge.geodesy import VehiclePosition
from edge.journal.records import PlaceFix
from edge.localization.dead_reckoning import GyroReading, Odometry
from edge.localization.odometer_calibration import ScaleFactor
from edge.reference_map import MapPlaces
from edge.sequence import PlaceMatch

GpsState: TypeAlias = Literal["healthy", "not healthy", "unknown"]
Moment: TypeAlias = Literal["exposure", "pose", "now"]
BOUND_WRONG = 0.1
"""Probability that the last aiding was wrong, where it was not a fix of ours: see `integrity`."""


@dataclass(frozen=True)
class GpsFix:
    """Where GPS says that the vehicle is at an exposure: degrees (WGS 84), one standard deviation in each direction."""

    lat_deg: float
    lon_deg: float
    sigma_m: float


GPS_SIGMA_M = 3.0
"""The least of a receiver, in each direction, whatever it reports: multipath is not in what it reports."""


class ImageProcessed(Struct, frozen=True, tag="Frame", rename={"timestamp_sigma_s": "undated_s"}):
    """The answer to one used frame.

    stamp_ns: its exposure. match: None while there is none. motion: by the vehicle's velocity at the exposure, None
    where that is unknown; without_gps: what is known of it by what GPS has no part in. gps: where GPS has the vehicle
    then.
    missed: places passed before it without a frame. in_line: whether the frame is part of the sequence, see
    `PlaceRecognizer`. timestamp_sigma_s: one standard deviation of the time of exposure.
    """

    stamp_ns: int
    match: PlaceMatch | None = None
    motion: Odometry | None = None
    without_gps: GyroReading | None = None
    gps: GpsFix | None = None
    missed: int = 0
    in_line: bool = True
    timestamp_sigma_s: float = 0.0


class AutopilotState(Struct, frozen=True, tag="Own"):
    """The autopilot state, as it reports it; None: not known.

    gps_why: why its state is unknown. gps_sigma_m: of `position` while GPS aids it, in each direction. motion: by its
    velocity at the position's moment. scale: what GPS has shown of the odometer by which the autopilot moves without
    it, see `OdometerCalibration`. accuracy_m: of the position, by its own word. driven_m: in all. is_aided: whether
    anything besides our positions measures its velocity. drives_itself: whether it steers the vehicle by that position,
    None where its mode is not known. fuses_poses: whether it fuses keypoint poses as measurements. is_doubled: whether
    two autopilots have its ids. is_clock_known: whether it is heard, and its boot clock is that of before.
    """

    gps: GpsState = "unknown"
    gps_why: str = ""
    gps_sigma_m: float | None = None
    position: VehiclePosition | None = None
    motion: Odometry | None = None
    scale: ScaleFactor | None = None
    accuracy_m: float | None = None
    speed_mps: float | None = None
    driven_m: float | None = None
    is_aided: bool = True
    drives_itself: bool | None = None
    fuses_poses: bool = False
    is_doubled: bool = False
    is_clock_known: bool = True


class OdometryUpdate(Struct, frozen=True, tag="Moved"):
    """How the vehicle has moved by now, by its velocity; None where that is unknown. For a position of now."""

    motion: Odometry | None


class FixFeedback(Struct, frozen=True, tag="Used"):
    """A position was sent. fix: None of one that nobody knows, as by a run before this one."""

    fix: Fix | None


class Discontinuity(Struct, frozen=True, tag="Break"):
    """A break in time: a blindness, a vehicle that was carried, an autopilot that rebooted.

    blind, carried: no position rests on frames from before; what is known of GPS stays. reboot: the autopilot may be
    another one, and its position has no aiding any more; what places and GPS showed of the vehicle holds as far as it
    can have gone meanwhile (`Odometry.unknown_m`).
    """

    kind: Literal["blind", "carried", "reboot"]


class ExternalPosition(Struct, frozen=True, tag=True):
    """Where the operator says that the vehicle is now: degrees (WGS 84), one standard deviation in each direction."""

    lat_deg: float
    lon_deg: float
    sigma_m: float


class MapUpdate(Struct, frozen=True, tag="Maps"):
    """The maps that are searched from now on. has_grown: those so far, with further places after theirs."""

    map_set: MapPlaces
    has_grown: bool = False


Event: TypeAlias = (
    ImageProcessed | AutopilotState | OdometryUpdate | FixFeedback | Discontinuity | ExternalPosition | MapUpdate
)


class ProtectionLevel(Struct, frozen=True, rename={"along_track_m": "along_m", "cross_track_m": "across_m"}):
    """A protection level: meters along-track and cross-track, infinite where nothing bounds the position."""

    along_track_m: float
    cross_track_m: float

    def is_within(self, limit_m: float) -> bool:
        """Whether neither is above a limit."""
        return max(self.along_track_m, self.cross_track_m) <= limit_m

    def or_more(self, other: ProtectionLevel) -> ProtectionLevel:
        """The larger one of both in each direction."""
        return ProtectionLevel(
            max(self.along_track_m, other.along_track_m), max(self.cross_track_m, other.cross_track_m)
        )


UNBOUNDED = ProtectionLevel(math.inf, math.inf)


class Fix(Struct, frozen=True, tag=True):
    """A position that may be published.

    level: how far off it may be, see `integrity`. bound_wrong: the probability that it is wrong as an aiding,
    once it was sent. motion: see `ImageProcessed`, at its moment. pose_sigma_m: one standard deviation, in each
    direction, of a keypoint pose without the error of the map; None of any other position.
    """

    place: PlaceFix
    level: ProtectionLevel
    bound_wrong: float = BOUND_WRONG
    motion: Odometry | None = None
    pose_sigma_m: float | None = None


class FixRequest(Struct, frozen=True, tag="Limits"):
    """What holds for a position beside what happened: of the message that would carry it, and of the moment.

    at: of the newest exposure; of the newest keypoint pose; or of now, but for an autopilot of the newest pose where
    there are poses: each is a measurement of its own, what is predicted between them is none. oldest_s: its age at
    most. is_reset: whether the autopilot uses it as it is instead of weighing it. moves_autopilot: whether it goes
    there; if not, neither its GPS nor its clock matters. unable: why nothing is recognized at this moment, "" while it
    is.
    """

    at: Moment = "exposure"
    oldest_s: float = math.inf
    is_reset: bool = False
    moves_autopilot: bool = True
    unable: str = ""
