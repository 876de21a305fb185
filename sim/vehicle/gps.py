"""What a simulated GPS receiver reports at one moment."""

from __future__ import annotations

from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim import Pose

USABLE_M = 20.0


@dataclass(frozen=True)
class GpsReport:
    """One report; fix_type as in MAVLink.

    accuracy_m: the receiver's own horizontal accuracy. east_off_m, north_off_m: how far its position is from the
    truth. second: it is the autopilot's second receiver, and the first has no fix.
    """

    fix_type: int = mavlink.GPS_FIX_TYPE_3D_FIX
    accuracy_m: float = 1.0
    east_off_m: float = 0.0
    north_off_m: float = 0.0
    second: bool = False

    @property
    def usable(self) -> bool:
        """Whether the autopilot's filter fuses it."""
        return self.fix_type >= mavlink.GPS_FIX_TYPE_3D_FIX and self.accuracy_m <= USABLE_M

    def position(self, pose: Pose) -> tuple[float, float]:
        """Meters east and north of the simulation's origin, for a vehicle at `pose`."""
        return pose.east_m + self.east_off_m, pose.north_m + self.north_off_m


NO_FIX = GpsReport(fix_type=mavlink.GPS_FIX_TYPE_NO_GPS, accuracy_m=0.0)
