"""Where the operator says that the vehicle is: by the live page, or by MAV_CMD_EXTERNAL_POSITION_ESTIMATE to us.

MAVLink has that command for "a remote pilot using landmarks over a video link". To the autopilot it would be a reset;
here it is one measurement more, so that one place near it is enough without GPS, and none that is wrong is believed
alone.
"""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.journal.records import PositionStated
from edge.localization import ExternalPosition, PositionEstimator
from edge.telemetry import encoders
from edge.telemetry.codec import Message
from edge.telemetry.people import Publisher
from edge.telemetry.vehicle import Vehicle

USUAL_M, LEAST_M, MOST_M = 30.0, 5.0, 1000.0
"""One standard deviation where none is stated, and its limits: nobody points at a map more exactly than the map is."""


class StatedPositions:
    """Reads what the operator says of one vehicle."""

    def __init__(self, vehicle: Vehicle, drive: PositionEstimator, publisher: Publisher) -> None:
        self._vehicle, self._drive, self._publisher = vehicle, drive, publisher

    def read(self, message: Message, now_ns: int) -> list[Message]:
        """A message addressed to us; the acknowledgement, if it is that command."""
        if getattr(message, "command", None) != encoders.EXTERNAL_POSITION_ESTIMATE:
            return []
        kind = message.get_type()
        if kind not in ("COMMAND_INT", "COMMAND_LONG"):  # an acknowledgement names it as well
            return []
        at = (message.x / 1e7, message.y / 1e7) if kind == "COMMAND_INT" else (message.param5, message.param6)
        asker = message.get_srcSystem(), message.get_srcComponent()
        is_rejected = self.use(*at, message.param3, "{}.{}".format(*asker), now_ns)
        result = mavlink.MAV_RESULT_DENIED if is_rejected else mavlink.MAV_RESULT_ACCEPTED
        return [encoders.acknowledgement(encoders.EXTERNAL_POSITION_ESTIMATE, result, 0, *asker)]

    def use(self, lat_deg: float, lon_deg: float, sigma_m: float, by: str, now_ns: int) -> str:
        """Count a position of now, in degrees (WGS 84), as a measurement; why it does not count, "" if it does.

        sigma_m: one standard deviation; 0 or NaN: not stated, and USUAL_M.
        """
        sigma_m = max(sigma_m, LEAST_M) if sigma_m > 0 else USUAL_M
        if not (abs(lat_deg) <= 90 and abs(lon_deg) <= 180 and sigma_m <= MOST_M):
            return f"no latitude, longitude and width of at most {MOST_M:.0f} m"
        is_by_gps = self._vehicle.session.gps.state(now_ns) == "healthy" and not self._drive.state.ignores_gps
        why = "" if self._vehicle.motion.displacement(now_ns) else "speed not known"
        if not (why := "GPS is in use" if is_by_gps else why):
            self._drive.update(now_ns, ExternalPosition(lat_deg, lon_deg, sigma_m))
        self._publisher.record(PositionStated(lat_deg, lon_deg, sigma_m, by, why))
        self._publisher.warn(f"Lookback: your position: {why or f'used, +-{sigma_m:.0f} m'}")
        return why
