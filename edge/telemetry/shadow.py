"""What would have been published without GPS, beside where GPS has the vehicle: for a drive that GPS judges.

A second estimator follows the same drive, as if GPS had been lost when the vehicle set off: GPS bounds neither its
estimate nor what it holds for possible, and no place is believed because GPS is near it. Else GPS would judge itself.
What stays of GPS is the autopilot's speed and heading, which GPS aids.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated

from msgspec import UNSET
from msgspec.structs import replace

from edge.config import Config
from edge.geodesy import VehiclePosition
from edge.journal.records import Direction, Heading, Latitude, Longitude, MapName, Order, Record, unit
from edge.localization import (
    AutopilotState,
    DeadReckoning,
    Discontinuity,
    Entry,
    Fix,
    FixRequest,
    ImageProcessed,
    MapUpdate,
    NoFix,
    OdometryUpdate,
    PositionEstimator,
)
from edge.telemetry.position_history import ExposureQueue, PositionHistory

PERIOD_NS, AGAIN_NS = 1_000_000_000, 200_000_000
"""Between two records; how soon it is asked again where no new picture was placed since the last one."""
LIMITS = FixRequest(oldest_s=5.0, moves_autopilot=False)
"""As old as an autopilot takes positions."""
OF_PLACE = "lat_deg", "lon_deg", "heading_deg", "sigma_along_m", "sigma_cross_track_m", "direction", "order", "map"
"""What a record has of its position."""


class ShadowPosition(Record, frozen=True, tag="shadow", omit_defaults=True):
    """What would have been published without GPS, beside where GPS has the vehicle: once a second of driving.

    Only with [telemetry] emit = "report", for `lookback shadow`. What is not known is not written.
    """

    stamp_ns: Annotated[int, unit("ns", "the exposure of the position; the moment itself where it is withheld")]
    speed_mps: Annotated[float, unit("m/s", "speed of the vehicle", 2)]
    driven_m: Annotated[float | None, unit("m", "distance driven since the start of the run", 2)] = None
    withheld: Annotated[str, unit("", 'why no position would have been published; "" where one would')] = ""
    gps_lat_deg: Annotated[float | None, unit("deg", "latitude of the autopilot at stamp_ns, null: unknown", 9)] = None
    gps_lon_deg: Annotated[float | None, unit("deg", "its longitude", 9)] = None
    gps_sigma_m: Annotated[
        float | None, unit("m", "one standard deviation of its distance from the truth, as the receiver reports it")
    ] = None
    gps_source: Annotated[str, unit("", "what that position rests on: gps, dgps, rtk_fixed, dead_reckoning ...")] = ""
    lat_deg: Latitude = None
    lon_deg: Longitude = None
    heading_deg: Heading = None
    sigma_along_m: Annotated[float | None, unit("m", "one standard deviation along-track", 2)] = None
    sigma_cross_track_m: Annotated[float | None, unit("m", "one standard deviation cross-track", 2)] = None
    direction: Direction | None = None
    order: Order | None = None
    map: MapName = UNSET


class Shadow:
    """Gets each entry of a drive's list, and writes a `ShadowPosition` for each second of driving."""

    def __init__(self, config: Config, record: Callable[[Record], object]) -> None:
        """record: writes to the journal."""
        self._estimator = PositionEstimator(config)
        self._record, self._min_speed_mps = record, config.gates.min_speed_mps
        self._was_bound = False
        self._due_ns, self._last_ns = 0, 0
        self._history: PositionHistory | None = None
        self._waiting: ExposureQueue[ShadowPosition]

    def update(self, t_ns: int, entry: Entry) -> None:
        """Follow the drive, without GPS from when it has aided the autopilot once."""
        match entry:
            case ImageProcessed():
                match = None if entry.match is None else entry.match.alone
                self._estimator.update(t_ns, replace(entry, match=match, gps=None))
            case AutopilotState():
                if not self._was_bound:
                    self._was_bound = entry.gps_sigma_m is not None
                    self._estimator.update(t_ns, entry)
                self._estimator.update(t_ns, replace(entry, gps="not healthy", gps_why="", gps_sigma_m=None))
            case Discontinuity() | MapUpdate() | OdometryUpdate():
                self._was_bound &= not (isinstance(entry, Discontinuity) and entry.kind == "reboot")
                self._estimator.update(t_ns, entry)

    def fix(self, now_ns: int, unable: str = "") -> Fix | NoFix:
        """What would be published now. unable: why nothing is recognized, "" while it is."""
        return self._estimator.fix(now_ns, replace(LIMITS, unable=unable))

    def turn(self, now_ns: int, motion: DeadReckoning, history: PositionHistory, unable: Callable[[], str]) -> None:
        """Once a turn. motion: of the vehicle. history: of the autopilot's own positions. unable: why nothing is
        recognized, "" while it is.
        """
        if self._history is None:
            self._history, self._waiting = history, ExposureQueue(history)
        self._write()
        speed_mps = motion.speed_mps(now_ns)
        if now_ns < self._due_ns or speed_mps is None or speed_mps < self._min_speed_mps:
            return
        answer = self.fix(now_ns, unable())
        place = answer.place if isinstance(answer, Fix) else None
        stamp_ns = now_ns if place is None else place.stamp_ns
        if stamp_ns <= self._last_ns:
            self._due_ns = now_ns + AGAIN_NS
            return
        self._last_ns, self._due_ns = stamp_ns, now_ns + PERIOD_NS
        found = ShadowPosition(stamp_ns, speed_mps, motion.driven_m(now_ns), "" if place else str(answer))
        of_place = {name: getattr(place, name) for name in OF_PLACE} if place else {}
        self._waiting.add(stamp_ns, replace(found, **of_place))

    def close(self) -> None:
        """Write what still waits for a position of the autopilot."""
        self._write(all_of_them=True)

    def _write(self, *, all_of_them: bool = False) -> None:
        if self._history is not None:
            for found, own in self._waiting.known(all_of_them=all_of_them):
                self._record(found if own is None else _beside(found, own))


def _beside(found: ShadowPosition, own: VehiclePosition) -> ShadowPosition:
    """A position, and where GPS has the vehicle."""
    gps = {"gps_lat_deg": own.lat_deg, "gps_lon_deg": own.lon_deg}
    return replace(found, **gps, gps_sigma_m=own.sigma_m, gps_source=own.source)
