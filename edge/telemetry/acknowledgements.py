"""What an acknowledgement of a position means for the next one, and whether an accepted position was used.

ACCEPTED  checked against the autopilot's own position, which must move: a filter that is not in use accepts as well
FAILED, TEMPORARILY_REJECTED, CANCELED  not now (GPS works, no origin, not dead reckoning): pause, longer each time
DENIED, UNSUPPORTED  never: no more until the autopilot reboots
no answer  send once more with the present age; PX4 1.15 never answers
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias

from pymavlink.dialects.v20 import common as mavlink

from edge.geodesy import VehiclePosition, east_north_of

Verdict: TypeAlias = Literal["accepted", "not now", "never", "wait"]

BACK_OFF_FIRST_NS = 1_000_000_000
BACK_OFF_LAST_NS = 30_000_000_000
ANSWER_NS = 1_000_000_000
NO_ANSWER = "NO_ANSWER"
CANCELED = 6  # MAV_RESULT_CANCELLED, which this dialect has no name for
MOVED_NS = 1_500_000_000
"""How long after ACCEPTED the position may take to move."""

VERDICTS: dict[int, Verdict] = {
    mavlink.MAV_RESULT_ACCEPTED: "accepted",
    mavlink.MAV_RESULT_TEMPORARILY_REJECTED: "not now",
    mavlink.MAV_RESULT_DENIED: "never",
    mavlink.MAV_RESULT_UNSUPPORTED: "never",
    mavlink.MAV_RESULT_FAILED: "not now",
    mavlink.MAV_RESULT_IN_PROGRESS: "wait",
    CANCELED: "not now",
    mavlink.MAV_RESULT_COMMAND_LONG_ONLY: "never",
    mavlink.MAV_RESULT_COMMAND_INT_ONLY: "never",
}


def result_name(result: int, kind: str = "MAV_RESULT", prefix: str = "MAV_RESULT_") -> str:
    """A result of that kind without the prefix; the number of one that the dialect does not know."""
    entry = mavlink.enums[kind].get(result)
    return entry.name.removeprefix(prefix) if entry else str(result)


@dataclass(frozen=True)
class Jump:
    """The jump that an accepted fix should cause: meters east and north, from the position before it."""

    before: VehiclePosition
    east_m: float
    north_m: float
    sigma_m: float

    def remaining_m(self, after: VehiclePosition) -> float:
        """How far the position still is from that of the fix, without what was driven since then.

        Driven by the mean of both velocities, since a vehicle turns and brakes meanwhile.
        """
        between_s = (after.stamp_ns - self.before.stamp_ns) / 1e9
        east_m, north_m = east_north_of(after.lat_deg, after.lon_deg, (self.before.lat_deg, self.before.lon_deg))
        driven_east_m = (self.before.east_mps + after.east_mps) / 2 * between_s
        driven_north_m = (self.before.north_mps + after.north_mps) / 2 * between_s
        return math.hypot(east_m - driven_east_m - self.east_m, north_m - driven_north_m - self.north_m)

    def happened(self, after: VehiclePosition) -> bool:
        """Whether the position moved at least half of the jump, or is within the standard deviation of the fix."""
        return self.remaining_m(after) <= max(self.sigma_m, math.hypot(self.east_m, self.north_m) / 2)
