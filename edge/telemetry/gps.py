"""GPS in three states, from its receivers (GPS_RAW_INT, GPS2_RAW) and from the flags of the autopilot's own filter.

healthy      a receiver has reported a 3-D fix of good accuracy for RETURN_NS, and the filter uses it
not healthy  no receiver has reported one for LOST_NS, after a short return for RETURN_NS, and all that were heard
             still report; or the filter is set to use none
unknown      anything else: a silent receiver, a fix that has just come back, a fix that the filter does not use

Only "not healthy" permits positions. GPS that comes and goes within RETURN_NS is unknown throughout: the filter follows
it, and is better at that alone.
"""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.geodesy import PositionSource, VehiclePosition, east_north_of, moved
from edge.localization import GPS_SIGMA_M, GpsFix, GpsState
from edge.telemetry.codec import Message

GPS_FRESH_NS = 3_000_000_000
LOST_NS = 1_000_000_000
RETURN_NS, FOLLOWED_NS = 5_000_000_000, 2_000_000_000
"""A fix is back after RETURN_NS. The filter follows one that was back for FOLLOWED_NS: when that goes again, it is lost
after RETURN_NS."""
UNUSED_NS = 3_000_000_000  # the filter gives GPS up a little before its receiver does
ABSENT_NS = 10_000_000_000
FIXES = range(mavlink.GPS_FIX_TYPE_3D_FIX, mavlink.GPS_FIX_TYPE_PPP + 1)  # DGPS, RTK and static as well
GOOD_M, BAD_M = 10.0, 25.0
"""Reported accuracy from which a fix becomes good, and beyond which it stays so no longer."""
M_PER_HDOP, UNREPORTED = 4.0, 65535
"""Where a receiver reports no accuracy, its HDOP stands for one: good up to 2.5, where PX4's EKF2_REQ_HDOP is."""
APART_SIGMAS, OFF_FIX_M, LATENCY_S, DATED_S = 3.0, 10.0, 0.3, 0.1
"""How far the filter's position may be from that of a receiver that it uses. LATENCY_S: of a fix that is dated by the
arrival of its message, DATED_S: by the autopilot's clock. They were 0.1 to 0.3 s and 0.07 s in ArduPilot's simulator,
0.04 s and none in PX4's."""
SOURCES: dict[int, PositionSource] = {
    mavlink.GPS_FIX_TYPE_DGPS: "dgps",
    mavlink.GPS_FIX_TYPE_RTK_FLOAT: "rtk_float",
    mavlink.GPS_FIX_TYPE_RTK_FIXED: "rtk_fixed",
    mavlink.GPS_FIX_TYPE_PPP: "ppp",
}
UNSTEADY = "its fix has just come or gone"


class _Fix:
    """Whether the fix of one receiver is healthy, by when it was good and when it was not."""

    def __init__(self) -> None:
        self.good_ns: int | None = None
        """Since when it has been, None while it is not."""
        self._bad_ns: int | None = None
        self._lost_ns = LOST_NS
        self.is_healthy, self._had_outage = False, False

    def begin(self) -> None:
        """Whoever reports now was silent before."""
        self.good_ns, self._bad_ns, self._lost_ns = None, None, LOST_NS

    def report(self, now_ns: int, *, is_good: bool) -> None:
        """It was reported."""
        if is_good:
            self.good_ns, self._bad_ns = now_ns if self.good_ns is None else self.good_ns, None
            return
        if self.good_ns is not None:
            was_followed = not self.is_healthy and now_ns - self.good_ns >= FOLLOWED_NS
            self._lost_ns = RETURN_NS if was_followed else LOST_NS
        self.good_ns, self._bad_ns = None, now_ns if self._bad_ns is None else self._bad_ns

    def state(self, now_ns: int, *, is_silent: bool) -> GpsState:
        """The state now, of a receiver that was heard once."""
        if is_silent or (self._bad_ns is not None and now_ns - self._bad_ns >= self._lost_ns):
            self.is_healthy, self._had_outage = False, True
            return "unknown" if is_silent else "not healthy"
        if self.good_ns is not None and (not self._had_outage or now_ns - self.good_ns >= RETURN_NS):
            self.is_healthy = True
        return "healthy" if self.is_healthy else "unknown"


class Receiver:
    """One receiver, by its messages; name: of the message."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.heard_ns: int | None = None
        self.fix_ns, self.latency_s = 0, LATENCY_S
        """When its newest fix was, and by how much it may have been before that."""
        self.accuracy_m: float | None = None
        """As it reports it, None where it does not."""
        self.source: PositionSource = "unknown"
        self.at = (0.0, 0.0)
        """Latitude and longitude in degrees (WGS 84)."""
        self._fix = _Fix()

    @property
    def sigma_m(self) -> float:
        """One standard deviation of its position."""
        return max(GPS_SIGMA_M, self.accuracy_m or 0.0)

    def read(self, message: Message, now_ns: int, fix_ns: int | None = None) -> None:
        """GPS_RAW_INT or GPS2_RAW; fix_ns: its time by the autopilot's clock, None without that.

        A receiver that counts the time of day instead is dated by the message's arrival.
        """
        self.state(now_ns)  # notices a silence before this message, which is an outage
        if self.is_silent(now_ns):
            self._fix.begin()
        self.heard_ns = now_ns
        accuracy_m = message.h_acc / 1000  # 0 where it is not reported
        by_hdop_m = M_PER_HDOP * message.eph / 100 if message.eph != UNREPORTED else 0.0
        is_good = message.fix_type in FIXES and (accuracy_m or by_hdop_m) <= (BAD_M if self._fix.is_healthy else GOOD_M)
        is_good = is_good and bool(message.lat or message.lon)
        if is_good:
            self.at = message.lat / 1e7, message.lon / 1e7
            is_dated = fix_ns is not None and 0 <= now_ns - fix_ns <= GPS_FRESH_NS
            self.fix_ns, self.latency_s = (fix_ns, DATED_S) if fix_ns is not None and is_dated else (now_ns, LATENCY_S)
            self.accuracy_m, self.source = accuracy_m or None, SOURCES.get(message.fix_type, "gps")
        self._fix.report(now_ns, is_good=is_good)

    @property
    def is_good(self) -> bool:
        """Whether its newest message has a good fix."""
        return self._fix.good_ns is not None

    def is_silent(self, now_ns: int) -> bool:
        """Whether it has not been heard for three seconds, or never."""
        return self.heard_ns is None or now_ns - self.heard_ns > GPS_FRESH_NS

    def state(self, now_ns: int) -> GpsState:
        """By this receiver alone."""
        return "unknown" if self.heard_ns is None else self._fix.state(now_ns, is_silent=self.is_silent(now_ns))


class Gps:
    """All receivers of one vehicle, in one session, and whether its filter uses them."""

    def __init__(self) -> None:
        self.receivers = (Receiver("GPS_RAW_INT"), Receiver("GPS2_RAW"))
        self.is_fusion_on: bool | None = None  # whether the filter is set to fuse them; None where that is not known
        self._flags_ns: int | None = None
        self._unused_ns: int | None = None  # since when the filter has not used it
        self._absent: tuple[int, int] | None = None  # since when SYS_STATUS says so, and when it did last

    def may_be_fused(self, *, is_selected: bool) -> bool:
        """Whether the filter may use them: by its own report, else as was selected."""
        return is_selected if self.is_fusion_on is None else self.is_fusion_on

    def read_filter(self, flags: int, glitch: int, now_ns: int) -> None:
        """The flags of EKF_STATUS_REPORT or ESTIMATOR_STATUS; glitch: that of a GPS which it rejects."""
        is_absolute = flags & mavlink.ESTIMATOR_POS_HORIZ_ABS and not flags & glitch
        is_used = is_absolute and self.is_fusion_on is not False  # its position is absolute by ours as well
        self._flags_ns = now_ns
        self._unused_ns = None if is_used else self._unused_ns or now_ns

    def read_sensors(self, present: int, now_ns: int) -> None:
        """The sensors that SYS_STATUS says are present: PX4 sends no GPS message where it has never had a receiver."""
        if present & mavlink.MAV_SYS_STATUS_SENSOR_GPS:
            self._absent = None
        else:
            self._absent = (self._absent or (now_ns, now_ns))[0], now_ns

    def receiver_state(self, now_ns: int) -> GpsState:
        """By the receivers alone, whether or not the filter uses them."""
        first, second = self.receivers[0].state(now_ns), self.receivers[1].state(now_ns)
        if "healthy" in (first, second):
            return "healthy"
        if self.receivers[0].heard_ns is None and self._is_absent(now_ns):
            first = "not healthy"
        if self.receivers[1].heard_ns is None:
            second = "not healthy"
        return "unknown" if "unknown" in (first, second) else "not healthy"

    def state(self, now_ns: int) -> GpsState:
        """By the receivers and the filter: one that does not fuse them has none."""
        if self.is_fusion_on is False:
            return "not healthy"
        state = self.receiver_state(now_ns)
        is_unused = self._hears_filter(now_ns) and self._unused_ns and now_ns - self._unused_ns >= UNUSED_NS
        return "unknown" if state == "healthy" and is_unused else state

    def why(self, now_ns: int) -> str:
        """Why the state is unknown, for people; "" where it is not."""
        if self.state(now_ns) != "unknown":
            return ""
        if self.receiver_state(now_ns) == "healthy":
            return "unused by the autopilot"
        silent = [one.name for one in self.receivers if one.state(now_ns) == "unknown" and one.is_silent(now_ns)]
        return f"no {silent[0]}" if silent else UNSTEADY

    def bound_m(self, own: VehiclePosition | None, now_ns: int) -> float | None:
        """One standard deviation of the autopilot's own position by GPS; None where GPS does not bound it."""
        receiver = self.behind(own, now_ns)
        return receiver.sigma_m if receiver and self._hears_filter(now_ns) else None

    def behind(self, own: VehiclePosition | None, now_ns: int) -> Receiver | None:
        """The receiver that the autopilot's own position agrees with, the less accurate of two; None: there is none.

        Nor where the filter reports that it does not use GPS.
        """
        if own is None or (self._unused_ns and self._hears_filter(now_ns)):
            return None
        near = [one for one in self.receivers if one.state(now_ns) == "healthy" and _is_near(one, own)]
        return max(near, key=lambda one: one.sigma_m, default=None)

    def fix(self, own: VehiclePosition | None, stamp_ns: int, now_ns: int) -> GpsFix | None:
        """Where the most accurate healthy receiver puts the vehicle at a moment.

        Not the filter's position: that resists a spoofing drift, then gives the receiver up, which is a jump (by 7 m on
        one flight: GPS was declared faulty 16 m off, instead of 7). None without a healthy receiver, and without the
        autopilot's velocity.
        """
        healthy = [one for one in self.receivers if one.state(now_ns) == "healthy"]
        if own is None or not healthy:
            return None
        best = min(healthy, key=lambda one: one.sigma_m)
        since_s = (stamp_ns - best.fix_ns) / 1e9
        sigma_m = math.hypot(best.sigma_m, best.latency_s * own.speed_mps)
        return GpsFix(*moved(*best.at, own.east_mps * since_s, own.north_mps * since_s), sigma_m)

    def _hears_filter(self, now_ns: int) -> bool:
        return self._flags_ns is not None and now_ns - self._flags_ns <= GPS_FRESH_NS

    def _is_absent(self, now_ns: int) -> bool:
        if self._absent is None:
            return False
        since_ns, last_ns = self._absent
        return last_ns - since_ns >= ABSENT_NS and now_ns - last_ns <= GPS_FRESH_NS


def _is_near(receiver: Receiver, own: VehiclePosition) -> bool:
    """Whether the autopilot's position is that of the receiver, as far as both are accurate."""
    apart_ns = receiver.fix_ns - own.stamp_ns
    east_m, north_m = east_north_of(*receiver.at, (own.lat_deg, own.lon_deg))
    apart_m = math.hypot(east_m - own.east_mps * apart_ns / 1e9, north_m - own.north_mps * apart_ns / 1e9)
    return apart_m <= max(OFF_FIX_M, APART_SIGMAS * receiver.sigma_m) + LATENCY_S * own.speed_mps
