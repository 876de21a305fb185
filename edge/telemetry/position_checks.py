"""Whether a fix may be sent: what bounds the autopilot's position, and the decision of `Integrity`."""

from __future__ import annotations

import math
from pathlib import Path

from edge.config import GatesConfig
from edge.localization import Integrity, PlaceFix, ProtectionLevel, Reckoning, Refusal, Situation, Uncertainty
from edge.telemetry.doubted_gps import DoubtedGps
from edge.telemetry.position_messages import PositionMessage
from edge.telemetry.remembered_bound import RememberedBound
from edge.telemetry.vehicle import Vehicle

REMEMBER_NS = 1_000_000_000
GROWS, BOUND, ACCURATE_M = 1.2, 2.0, 10.0
"""A reset is not sent where it is less certain than the autopilot; GROWS is by how much one position becomes so after
another on recorded drives (of 551, two by more). Of one that is less accurate than ACCURATE_M the autopilot must be
BOUND times as uncertain, since its uncertainty by the distance driven is a bound, not what is expected; where nothing
measures its velocity, none is sent. Messages that are weighed need none of this."""
CALLED_SIGMA_M = 10.0
"""Of the autopilot's position less the error of GPS, when GPS is called wrong."""


class PositionChecks:
    """For the one link that carries positions."""

    def __init__(self, gates: GatesConfig, vehicle: Vehicle, doubted_gps: DoubtedGps, remembered: Path | None) -> None:
        """remembered: file that keeps over a restart what bounds the position."""
        self._vehicle, self._doubted_gps = vehicle, doubted_gps
        self._uncertainty = Uncertainty(gates.drift_percent)
        self._reckoning = Reckoning(gates.drift_percent)
        self._remembered = RememberedBound(remembered, gates.drift_percent)
        self._integrity = Integrity(gates)
        self._velocity_error = 0.0  # of the autopilot, by the newest fix
        self._remember_due_ns = 0

    def reset(self) -> None:
        """The autopilot may be another one, or has rebooted: nothing bounds its position any more.

        What places and GPS showed of the vehicle holds as far as it can have gone meanwhile.
        """
        self._uncertainty.reset()

    @property
    def protection_level(self) -> ProtectionLevel | None:
        """Of the newest fix that was checked; None where its place is not certain enough to be sent."""
        return self._integrity.protection_level

    @property
    def is_bounded(self) -> bool:
        """Whether GPS or a position of ours has bounded the autopilot's since its boot."""
        return self._uncertainty.is_bounded

    def uncertainty_m(self, now_ns: int) -> float | None:
        """One standard deviation of the autopilot's own position, None where nothing has ever bound it."""
        vehicle = self._vehicle
        if not vehicle.is_aided:
            return None
        return self._uncertainty.at(vehicle.driven_m(now_ns), vehicle.accuracy_m(now_ns), self._velocity_error)

    def refusal(
        self, fix: PlaceFix, message: PositionMessage, last_sent_ns: int | None, period_s: float, now_ns: int
    ) -> Refusal | None:
        """Why the fix may not be sent by that message; None if it may. last_sent_ns: of the last fix."""
        vehicle, situation = self._vehicle, self._situation(fix, now_ns, last_sent_ns)
        refused = self._integrity.refusal(fix, situation, period_s, message.max_age_s)
        known_m = situation.uncertainty_m
        if refused is not None:
            return refused
        most_m = math.inf
        if not vehicle.is_aided:
            most_m = ACCURATE_M
        elif message.acknowledged and known_m is not None:
            most_m = max(min(GROWS * known_m, ACCURATE_M), known_m / BOUND)
        return Refusal("less accurate than the autopilot") if fix.sigma_m > most_m else None

    def observe(self, fix: PlaceFix, now_ns: int) -> None:
        """The fix of a new match, as evidence for those that will be sent."""
        self._integrity.observe(fix, self._situation(fix, now_ns, None))

    def _situation(self, fix: PlaceFix, now_ns: int, last_sent_ns: int | None) -> Situation:
        vehicle, self._velocity_error = self._vehicle, fix.velocity_error
        displacement = vehicle.displacement(fix.stamp_ns)
        reckoned = self._reckoning.at(fix, displacement, vehicle.driven_m(now_ns))
        own, sigma_m = self._doubted_gps.corrected(vehicle.position(now_ns)), self.uncertainty_m(now_ns)
        is_by_gps = self._uncertainty.by_gps
        if not vehicle.is_aided:  # its own position has run away, or is ours
            own = None
        if sigma_m is None and reckoned is not None:  # as after a reboot too
            own, sigma_m, is_by_gps = reckoned.position(fix), reckoned.sigma_m, True
        return Situation(
            now_ns,
            "not healthy" if self._doubted_gps.is_ignored else vehicle.gps.state(now_ns),
            vehicle.speed_mps(now_ns),
            own,
            sigma_m,
            is_by_gps,
            last_sent_ns,
            displacement,
            reckoned,
        )

    def bind(self, sigma_m: float, now_ns: int, *, by_gps: bool = False) -> None:
        """The autopilot's position is as good as that now; of one that nothing aids, only while GPS says so."""
        if not (by_gps or self._vehicle.is_aided):
            return
        vehicle, driven_m = self._vehicle, self._vehicle.driven_m(now_ns)
        self._uncertainty.bind(sigma_m, driven_m, by_gps=by_gps)
        self._integrity.bound(by_gps=by_gps)
        if not by_gps:
            self._doubted_gps.bound()
        elif (own := vehicle.position(now_ns)) is not None and driven_m is not None:
            self._reckoning.bind(own, vehicle.displacement(own.stamp_ns), driven_m, sigma_m)

    def leave_gps(self, now_ns: int) -> None:
        """GPS was called wrong and is ignored: what it has contradicted so far is not contradicted any more."""
        self._uncertainty.bind(CALLED_SIGMA_M, self._vehicle.driven_m(now_ns))
        self._integrity.bound(by_gps=False)
        self._reckoning.reset()

    def remember(self, now_ns: int) -> None:
        """Keep what bounds the autopilot's position over a restart of this program, or use what was kept."""
        if now_ns < self._remember_due_ns or not self._vehicle.is_aided:
            return
        self._remember_due_ns = now_ns + REMEMBER_NS
        ours_m = self._uncertainty.at(self._vehicle.driven_m(now_ns), None)
        if ours_m is not None:
            self._remembered.keep(ours_m, self._vehicle, now_ns, by_fixes=self._vehicle.has_our_position)
        elif (remembered := self._remembered.recall(self._vehicle, now_ns)) is not None:
            remembered_m, by_fixes = remembered
            self.bind(remembered_m, now_ns)
            self._vehicle.has_our_position |= by_fixes
