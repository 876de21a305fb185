"""What the places say of GPS, published to people, the journal and scripts. No I/O."""

from __future__ import annotations

from edge.journal.records import GpsJudged
from edge.localization import GpsVerdict
from edge.telemetry import encoders
from edge.telemetry.codec import Message
from edge.telemetry.link_protocol import Publisher
from edge.telemetry.vehicle import Vehicle

VALUES_NS = 1_000_000_000
TEXTS = {
    "wrong": "Lookback: GPS is wrong by {}",
    "agrees": "Lookback: GPS agrees with the map again",
    "map shifted": "Lookback: GPS is {} of the whole map",
    "not recognized": "Lookback: not recognized where GPS says we are",
}


class DoubtedGps:
    """The newest verdict, and what was published of it."""

    def __init__(self, vehicle: Vehicle, publisher: Publisher) -> None:
        self._vehicle, self._publisher = vehicle, publisher
        self.verdict: GpsVerdict | None = None
        self._published = ""
        self._values_ns = 0

    def publish(self, verdict: GpsVerdict) -> bool:
        """Publish a verdict where it is another one; True where GPS was just called wrong."""
        self.verdict, before = verdict, self._published
        if verdict.state == before or (not before and verdict.state == "cannot say"):
            return False
        self._published = verdict.state
        east_m, north_m, doubt = (
            None if value is None else round(value, digits)
            for value, digits in ((verdict.east_m, 1), (verdict.north_m, 1), (verdict.doubt, 2))
        )
        self._publisher.record(GpsJudged(verdict.state, east_m, north_m, doubt))
        if verdict.state in TEXTS and (verdict.state != "agrees" or before == "wrong"):
            self._publisher.warn(TEXTS[verdict.state].format(verdict.where))
        return verdict.state == "wrong"

    def due(self, now_ns: int) -> list[Message]:
        """The values for ground stations and scripts, once a second from the first answer on."""
        if self.verdict is None or not self._published or now_ns < self._values_ns:
            return []
        self._values_ns = now_ns + VALUES_NS
        boot_ms = round((self._vehicle.boot_time_s(now_ns) or 0.0) * 1000)
        return encoders.gps_values(self.verdict.doubt, self.verdict.distance_m, boot_ms)
