"""What the places say of GPS: published to people, the journal and scripts, and whether GPS is ignored. No I/O."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from edge.config import GatesConfig
from edge.geodesy import VehiclePosition, moved
from edge.journal.records import GpsJudged, Record
from edge.localization import GpsVerdict
from edge.telemetry import encoders
from edge.telemetry.codec import Message
from edge.telemetry.vehicle import Vehicle

VALUES_NS = 1_000_000_000
TEXTS = {
    "wrong": "Lookback: GPS is wrong by {}",
    "agrees": "Lookback: GPS agrees with the map again",
    "map shifted": "Lookback: GPS is {} of the whole map",
    "not recognized": "Lookback: not recognized where GPS says we are",
}


class DoubtedGps:
    """The newest verdict. GPS that was called wrong counts as wrong until it agrees again."""

    def __init__(
        self,
        gates: GatesConfig,
        vehicle: Vehicle,
        record: Callable[[Record], object],
        send_text: Callable[[str], object],
    ) -> None:
        self._acts, self._vehicle = gates.doubted_gps != "report", vehicle
        self._record, self._send_text = record, send_text
        self.verdict: GpsVerdict | None = None
        self.is_wrong = False
        """Whether GPS was called wrong, and has not agreed since."""
        self._published = ""
        self._values_ns = 0
        self._error_m: tuple[float, float] | None = None

    @property
    def is_ignored(self) -> bool:
        """Whether positions are published as if GPS were lost."""
        return self.is_wrong and self._acts

    def judge(self, verdict: GpsVerdict, now_ns: int) -> bool:
        """Publish a verdict where it is another one; True when GPS was just called wrong."""
        was_wrong, self.verdict = self.is_wrong, verdict
        self.is_wrong = verdict.state == "wrong" or (was_wrong and verdict.state != "agrees")
        self._keep_error(verdict, now_ns)
        state = "wrong" if self.is_wrong else verdict.state
        if state != self._published and (self._published or state != "cannot say"):
            self._publish(state, verdict, was_wrong=was_wrong)
        return self.is_wrong and not was_wrong

    def _keep_error(self, verdict: GpsVerdict, now_ns: int) -> None:
        """By how much the autopilot's position is wrong: by the error of GPS, as long as it follows GPS."""
        follows = self._vehicle.gps.bound_m(self._vehicle.position(now_ns), now_ns) is not None
        if not self.is_wrong:
            self._error_m = None
        elif follows and verdict.east_m is not None and verdict.north_m is not None:
            self._error_m = verdict.east_m, verdict.north_m

    def _publish(self, state: str, verdict: GpsVerdict, *, was_wrong: bool) -> None:
        self._published = state
        east_m, north_m, doubt = (
            None if value is None else round(value, digits)
            for value, digits in ((verdict.east_m, 1), (verdict.north_m, 1), (verdict.doubt, 2))
        )
        self._record(GpsJudged(state, east_m, north_m, doubt))
        if state in TEXTS and (state != "agrees" or was_wrong):
            self._send_text(TEXTS[state].format(verdict.where))

    def corrected(self, own: VehiclePosition | None) -> VehiclePosition | None:
        """Where the autopilot would be without the error of GPS that it has followed."""
        if own is None or self._error_m is None:
            return own
        lat_deg, lon_deg = moved(own.lat_deg, own.lon_deg, -self._error_m[0], -self._error_m[1])
        return replace(own, lat_deg=lat_deg, lon_deg=lon_deg)

    def bound(self) -> None:
        """The autopilot is where a position has put it: the error of GPS is no longer in it."""
        self._error_m = None

    def due(self, now_ns: int) -> list[Message]:
        """The values for ground stations and scripts, once a second from the first answer on."""
        if self.verdict is None or not self._published or now_ns < self._values_ns:
            return []
        self._values_ns = now_ns + VALUES_NS
        boot_ms = round((self._vehicle.boot_time_s(now_ns) or 0.0) * 1000)
        doubt = 1.0 if self.is_wrong else self.verdict.doubt
        return encoders.gps_values(doubt, self.verdict.distance_m, boot_ms)
