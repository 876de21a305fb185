"""By what the vehicle steers, and whether GPS is in use: one state for the page, /metrics, the journal and pilots."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

from edge.journal.records import SteeringChanged
from edge.localization import EstimatorState
from edge.telemetry.people import Publisher
from edge.telemetry.vehicle import Vehicle

GpsUse: TypeAlias = Literal["in use", "not used", "lost", "faulty", "unknown"]
SteeredBy: TypeAlias = Literal["GPS", "places", "dead reckoning", "unknown"]
HELD_NS, CONFIRMED_NS = 3_000_000_000, 10_000_000_000
"""So long a state lasts before it is published; and so long after its autopilot last agreed with a position that was
sent, a vehicle steers by places."""


@dataclass(frozen=True)
class Steering:
    """The state. reckoned_m: driven by dead reckoning alone; None where that is not so, or not known."""

    gps: GpsUse = "unknown"
    by: SteeredBy = "unknown"
    reckoned_m: float | None = None

    def __str__(self) -> str:
        gps = f"GPS {self.gps.upper() if self.gps in ('lost', 'faulty') else self.gps}"
        return f"{gps}, position unknown" if self.by == "unknown" else f"{gps}, steers by {self.by}"


class SteeringMonitor:
    """Follows the state of one vehicle, and publishes each that lasts."""

    def __init__(self, vehicle: Vehicle, publisher: Publisher) -> None:
        self._vehicle, self._publisher = vehicle, publisher
        self.state, self._published, self._since_ns = Steering(), "", 0
        self._reckoned_from_m: float | None = None

    def update(self, now_ns: int, known: EstimatorState, confirmed_ns: int | None, *, is_selected: bool) -> None:
        """The state from now on. confirmed_ns: see `PositionUse`. is_selected: whether the sources with GPS are."""
        vehicle, before = self._vehicle, self.state
        gps, driven_m = vehicle.session.gps, vehicle.motion.driven_m(now_ns)
        receivers, is_faulty = gps.receiver_state(now_ns), known.gps.state == "faulty"
        is_used = gps.state(now_ns) == "healthy" and gps.may_be_fused(is_selected=is_selected)
        use: GpsUse = "in use" if is_used else "not used" if receivers == "healthy" else "unknown"
        use = "lost" if receivers == "not healthy" else "faulty" if is_faulty else use
        by: SteeredBy = "GPS" if is_used else "unknown"
        if not is_used and confirmed_ns is not None and now_ns - confirmed_ns < CONFIRMED_NS:
            by = "places"
        elif not is_used and use != "unknown" and known.is_bounded and vehicle.position(now_ns) is not None:
            by = "dead reckoning"
        if by != "dead reckoning" or self._reckoned_from_m is None or driven_m is None:
            self._reckoned_from_m = driven_m
        start_m = self._reckoned_from_m if by == "dead reckoning" else None
        self.state = Steering(use, by, None if driven_m is None or start_m is None else round(driven_m - start_m, 1))
        self._since_ns = self._since_ns if str(self.state) == str(before) else now_ns
        if use == "unknown" or str(self.state) == self._published or now_ns - self._since_ns < HELD_NS:
            return
        if self._published or not is_used:
            self._publisher.warn(f"Lookback: {self.state}")
        self._published = str(self.state)
        self._publisher.record(SteeringChanged(use, by))
