"""GPS in three states, by messages on the link: what is sent, what bounds the autopilot's position, what is said."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.config import GatesConfig
from edge.geodesy import VehiclePosition, east_north_of, moved
from edge.journal.records import FixSent, FixWithheld
from edge.telemetry.codec import MavlinkCodec
from edge.telemetry.gps import Gps
from edge.telemetry.link_protocol import STREAMS_HZ
from edge.telemetry.vehicle import Vehicle
from sim.vehicle.command import straight_line
from tests.telemetry.rig import OpenRig, Rig
from tests.tlog import messages_of

OFTEN = GatesConfig(min_interval_s=0.5, risk=1.0, min_move_m=0.0)
GPS_EACH_NS = 250_000_000
FLIGHTS = Path(__file__).parents[3] / "shared" / "flights"
NO_FIX, FIX_3D = 1, 3


@pytest.mark.parametrize(
    ("h_acc_mm", "hdop", "state"),
    [
        (0, 99.0, "not healthy"),
        (0, 2.6, "not healthy"),
        (0, 2.4, "healthy"),
        (1500, 99.0, "healthy"),
        (0, 655.35, "healthy"),
    ],
)
def test_where_no_accuracy_is_reported_the_hdop_says_how_good_a_fix_is(h_acc_mm: int, hdop: float, state: str) -> None:
    """655.35 stands for one that is not reported either."""
    gps = Gps()
    for now_ns in range(0, 5_000_000_000, 250_000_000):
        fix = -274772000, 1530283000, 0, round(100 * hdop), 65535, 0, 0, 4
        gps.receivers[0].read(mavlink.MAVLink_gps_raw_int_message(0, FIX_3D, *fix, 0, h_acc_mm), now_ns)
    assert gps.receiver_state(now_ns) == state


def test_of_two_receivers_the_less_accurate_one_bounds_the_position() -> None:
    gps = Gps()
    for now_ns in range(0, 6_000_000_000, 250_000_000):
        for receiver, h_acc_mm in zip(gps.receivers, (1500, 6000), strict=True):
            fix = -274772000, 1530283000, 0, 65535, 65535, 0, 0, 4
            receiver.read(mavlink.MAVLink_gps_raw_int_message(0, FIX_3D, *fix, 0, h_acc_mm), now_ns)
    own = VehiclePosition(now_ns, -27.4772, 153.0283, 0.0, None, 0.0, 0.0, 0.0)
    assert gps.behind(own, now_ns) is gps.receivers[1]


def test_an_absolute_position_of_px4_is_not_by_gps_that_it_is_set_not_to_fuse() -> None:
    """With our positions its filter reports one as well."""
    states = {}
    for is_on in (None, True, False):
        gps = Gps()
        gps.is_fusion_on = is_on
        for now_ns in range(0, 9_000_000_000, 250_000_000):
            fix = -274772000, 1530283000, 0, 65535, 65535, 0, 0, 4
            gps.receivers[0].read(mavlink.MAVLink_gps_raw_int_message(0, FIX_3D, *fix, 0, 1500), now_ns)
            gps.read_filter(mavlink.ESTIMATOR_POS_HORIZ_ABS, mavlink.ESTIMATOR_GPS_GLITCH, now_ns)
        states[is_on] = gps.state(now_ns)
    assert states == {None: "healthy", True: "healthy", False: "not healthy"}


class Sky:
    """Receivers and filter flags of a simulated autopilot, in place of its own; None is silence."""

    def __init__(self, rig: Rig, first: int | None = FIX_3D, second: int | None = None) -> None:
        self.rig, self.first, self.second = rig, first, second
        self.h_acc_mm = 1500
        self.flags: int | None = 0x33F
        self.off_m = 0.0
        """How far north of the truth the receivers report."""
        self._codec = MavlinkCodec(1, 1)
        self._due_ns = 0
        rig.wire.loses = self._loses

    def run(self, seconds: float, each: Callable[[], object] = lambda: None) -> None:
        def turn() -> bool:
            if self.rig.now_ns >= self._due_ns:
                self._due_ns = self.rig.now_ns + GPS_EACH_NS
                each()
                self._send()
            return False

        self.rig.run(seconds, turn)

    def offer(self, seconds: float, each: Callable[[], object] = lambda: None, **changes: Any) -> int:
        """Offer fixes meanwhile; how many were sent."""
        sent = 0

        def turn() -> None:
            nonlocal sent
            each()
            sent += self.rig.send_position(self.rig.fix(**changes))

        self.run(seconds, turn)
        return sent

    def _loses(self, message: Any) -> bool:
        return message.get_type() in ("GPS_RAW_INT", "EKF_STATUS_REPORT")

    def _send(self) -> None:
        lat_deg, lon_deg = straight_line(8.0, 60.0, 1000.0)(self.rig.now_ns / 1e9).geodetic()
        place = round((lat_deg + self.off_m / 111_000) * 1e7), round(lon_deg * 1e7), 20_000, 100, 100, 0, 0, 10
        if self.first is not None:
            self._say(mavlink.MAVLink_gps_raw_int_message(0, self.first, *place, 0, self.h_acc_mm))
        if self.second is not None:
            self._say(mavlink.MAVLink_gps2_raw_message(0, self.second, *place, 0, 0, 0, 0, self.h_acc_mm))
        if self.flags is not None:
            self._say(mavlink.MAVLink_ekf_status_report_message(self.flags, *[0.0] * 5))

    def _say(self, message: Any) -> None:
        assert self.rig.pty is not None
        self.rig.pty.send(self._codec.encode(message))

    @property
    def state(self) -> str:
        return str(self.rig.connection.vehicle.session.gps.state(self.rig.now_ns))


@pytest.fixture
def rig(open_rig: OpenRig) -> Rig:
    rig = open_rig(emit="external_position", gates=OFTEN, gps=False)
    rig.run(2.0)
    return rig


@pytest.mark.parametrize("fix_type", [3, 4, 5, 6, 7, 8], ids=["3-D", "DGPS", "float", "fixed", "static", "PPP"])
@pytest.mark.parametrize("receiver", ["first", "second"])
def test_every_good_fix_of_either_receiver_withholds(rig: Rig, fix_type: int, receiver: str) -> None:
    sky = Sky(rig, NO_FIX, NO_FIX)
    setattr(sky, receiver, fix_type)
    sky.run(6.0)
    assert sky.state == "healthy"
    assert sky.offer(4.0) == 0
    assert rig.journalled(FixWithheld)[-1].reason == "GPS is healthy"


@pytest.mark.parametrize(("fix_type", "h_acc_mm"), [(0, 1500), (1, 1500), (2, 1500), (9, 1500), (FIX_3D, 500_000)])
def test_no_fix_and_one_without_height_or_accuracy_do_not_withhold(rig: Rig, fix_type: int, h_acc_mm: int) -> None:
    sky = Sky(rig, fix_type)
    sky.h_acc_mm = h_acc_mm
    sky.run(3.0)
    assert sky.state == "not healthy" and rig.bounded_m is None
    assert sky.offer(3.0) >= 2


def test_accuracy_around_the_limit_does_not_flicker(rig: Rig) -> None:
    sky, states = Sky(rig), []
    sky.run(2.0)

    def vary() -> None:
        sky.h_acc_mm = 8_000 if sky.h_acc_mm == 20_000 else 20_000
        states.append(sky.state)

    sky.run(20.0, vary)
    assert set(states) == {"healthy"}


@pytest.mark.parametrize("lost", ["GPS_RAW_INT", "request"])
def test_gps_that_was_never_heard_is_unknown_and_nothing_is_sent(rig: Rig, lost: str) -> None:
    rig.connection.close()
    rig.crash()
    gps = mavlink.MAVLINK_MSG_ID_GPS_RAW_INT
    if lost == "request":
        rig.autopilot.reboot()
        rig.wire.loses = lambda one: one.get_type() == "COMMAND_LONG" and (one.command, one.param1) == (511, gps)
    else:
        rig.wire.loses = lambda one: one.get_type() == lost
    rig.connect()
    sent = len(rig.journalled(FixSent))
    rig.run(20.0, lambda: rig.send_position(rig.fix()))
    assert len(rig.journalled(FixSent)) == sent
    assert rig.journalled(FixWithheld)[-1].reason == "GPS is unknown: no GPS_RAW_INT"
    assert rig.connection.why_no_position == "GPS is unknown: no GPS_RAW_INT"
    rig.wire.loses = None
    rig.run(60.0, lambda: rig.connection.vehicle.session.gps.state(rig.now_ns) != "unknown")
    rig.run(2.0)
    assert rig.send_position(rig.fix())


def test_a_receiver_that_goes_silent_is_unknown_though_the_other_has_no_fix(rig: Rig) -> None:
    sky = Sky(rig, NO_FIX, FIX_3D)
    sky.run(6.0)
    sky.second = None
    sky.run(5.0)
    assert sky.state == "unknown"
    assert sky.offer(3.0) == 0
    assert rig.journalled(FixWithheld)[-1].reason == "GPS is unknown: no GPS2_RAW"


def test_the_loss_of_the_fix_is_noticed_after_a_second(rig: Rig) -> None:
    sky = Sky(rig)
    sky.run(6.0)
    sky.first = NO_FIX
    assert sky.offer(0.9) == 0
    sky.run(0.5)
    assert sky.state == "not healthy"


@pytest.mark.parametrize("good_s", [0.25, 1.0, 3.0])
def test_gps_that_flickers_every_four_seconds_is_never_healthy_and_bounds_nothing(rig: Rig, good_s: float) -> None:
    sky, states = Sky(rig, NO_FIX), []
    sky.run(3.0)

    def flicker() -> None:
        sky.first = FIX_3D if (rig.now_ns / 1e9) % 4.0 < good_s else NO_FIX
        states.append(sky.state)

    sky.run(40.0, flicker)
    assert "healthy" not in states
    assert rig.bounded_m is None
    sent = sky.offer(20.0, flicker)
    # A second after each loss, until it is back; where it is back for long enough that the filter follows it, never.
    assert sent > 0 if good_s < 2.0 else sent == 0


@pytest.mark.parametrize(
    ("good_s", "then", "unknown_s", "last"),
    [(3.0, NO_FIX, 4.0, "not healthy"), (0.0, FIX_3D, 4.5, "healthy")],
    ids=["lost again", "stays"],
)
def test_a_fix_that_comes_back_counts_after_five_seconds(
    rig: Rig, good_s: float, then: int, unknown_s: float, last: str
) -> None:
    """And one that was back for three seconds is lost after five."""
    sky = Sky(rig, NO_FIX)
    sky.run(3.0)
    sky.first = FIX_3D
    sky.run(good_s)
    sky.first = then
    sky.run(unknown_s)
    assert sky.state == "unknown"
    sky.run(1.5)
    assert sky.state == last


def test_one_good_message_after_an_outage_bounds_nothing(rig: Rig) -> None:
    sky = Sky(rig)
    sky.run(6.0)
    sky.first, sky.flags = NO_FIX, 0x12F
    sky.run(20.0)
    before_m = rig.uncertainty_m
    sky.first, sky.flags = FIX_3D, 0x33F
    sky.run(0.25)
    sky.first = NO_FIX
    sky.run(1.5)
    assert rig.uncertainty_m >= before_m
    assert sky.state == "not healthy"


def test_gps_bounds_the_position_by_its_accuracy(rig: Rig) -> None:
    sky = Sky(rig)
    sky.h_acc_mm = 7_000
    sky.run(6.0)
    assert rig.bounded_m == pytest.approx(7.0)
    sky.h_acc_mm = 300
    sky.run(1.0)
    assert rig.bounded_m == pytest.approx(3.0)


@pytest.mark.parametrize("flags", [0x12F, 0x33F | 1 << 15, None], ids=["no absolute position", "glitch", "silent"])
def test_gps_that_the_filter_does_not_use_bounds_nothing_and_is_no_permission(rig: Rig, flags: int | None) -> None:
    """A vehicle with EK3_SRC1_POSXY 0 ignores a good GPS and drifts."""
    sky = Sky(rig)
    sky.flags = flags
    sky.run(8.0)
    assert rig.bounded_m is None
    assert sky.offer(4.0) == 0
    if flags is not None:
        assert rig.journalled(FixWithheld)[-1].reason == "GPS is unknown: unused by the autopilot"


@pytest.mark.parametrize("drift_mps", [0.5, 2.0, 5.0])
def test_gps_that_is_spoofed_off_bounds_no_longer_once_the_filter_does_not_follow(rig: Rig, drift_mps: float) -> None:
    sky = Sky(rig)
    sky.run(6.0)
    bound_m = rig.uncertainty_m
    off_m = []

    def drag() -> None:
        sky.off_m += drift_mps * GPS_EACH_NS / 1e9
        if rig.uncertainty_m <= bound_m + 0.01:
            off_m.append(sky.off_m)

    sky.run(60.0, drag)
    assert max(off_m) < 10.0 + 0.3 * 8.0 + drift_mps
    assert rig.uncertainty_m > bound_m + 1.0
    assert sky.offer(3.0, drag) == 0, "the receiver is still good"


def test_a_px4_without_any_receiver_is_known_not_to_have_gps() -> None:
    vehicle, codec, their = Vehicle(), MavlinkCodec(1, 191), MavlinkCodec(1, 1)
    seconds = 1_000_000_000

    def hear(message: Any, now_ns: int) -> None:
        for one in codec.decode(their.encode(message)):
            vehicle.handle(one, now_ns)

    for second in range(14):
        hear(mavlink.MAVLink_heartbeat_message(10, mavlink.MAV_AUTOPILOT_PX4, 0, 0, 4, 3), second * seconds)
        hear(mavlink.MAVLink_sys_status_message(0x1F, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0), second * seconds)
        assert vehicle.session.gps.state(second * seconds) == ("not healthy" if second >= 11 else "unknown")
    assert vehicle.session.gps.state(20 * seconds) == "unknown", "SYS_STATUS is silent"


@pytest.mark.parametrize(("epoch_s", "late_m"), [(0, 0.0), (1_790_000_000, 2.0)], ids=["boot", "time of day"])
def test_gps_puts_a_vehicle_where_its_receiver_does_at_the_time_of_the_fix(epoch_s: int, late_m: float) -> None:
    """At 10 m/s, by fixes that arrive after 0.2 s; the filter resists a spoofing drift, and is 6 m behind."""
    vehicle, codec, their, latency_ns = Vehicle(), MavlinkCodec(1, 191), MavlinkCodec(1, 1), 200_000_000

    def hear(message: Any, now_ns: int) -> None:
        for one in codec.decode(their.encode(message)):
            vehicle.handle(one, now_ns)

    def at(now_ns: int, behind_m: float = 0.0) -> tuple[float, float]:
        return moved(-27.47, 153.02, now_ns / 1e8 - behind_m, 0.0)

    for now_ns in range(0, 8_000_000_000, 250_000_000):
        filtered, received = at(now_ns, 6.0), at(now_ns - latency_ns)
        place = round(filtered[0] * 1e7), round(filtered[1] * 1e7), 0, 0
        hear(mavlink.MAVLink_heartbeat_message(10, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, 4, 3), now_ns)
        hear(mavlink.MAVLink_global_position_int_message(now_ns // 1_000_000, *place, 0, 1000, 0, 9000), now_ns)
        hear(mavlink.MAVLink_ekf_status_report_message(0x33F, *[0.0] * 5), now_ns)
        fix = round(received[0] * 1e7), round(received[1] * 1e7), 0, 100, 100, 0, 0, 10
        fix_us = epoch_s * 1_000_000 + max(now_ns - latency_ns, 0) // 1000
        hear(mavlink.MAVLink_gps_raw_int_message(fix_us, FIX_3D, *fix, 0, 1500), now_ns)
    gps = vehicle.gps_fix(now_ns, now_ns)
    assert gps is not None
    assert east_north_of(gps.lat_deg, gps.lon_deg, at(now_ns)) == pytest.approx((-late_m, 0.0), abs=0.05)
    assert gps.sigma_m == pytest.approx(4.24 if late_m else 3.16, abs=0.01)


def streams_requested(rig: Rig) -> list[int]:
    return [int(one.param1) for one in rig.received("COMMAND_LONG") if one.command == 511]


def test_streams_are_requested_one_by_one_and_again_when_silent(rig: Rig) -> None:
    """Those that the autopilot refuses are left alone, and only the one that is silent is requested again."""
    rig.run(2.0)
    once = streams_requested(rig)
    assert once == list(STREAMS_HZ)
    rig.run(100.0)
    refused = streams_requested(rig)[len(once) :]
    gps, second_gps = mavlink.MAVLINK_MSG_ID_GPS_RAW_INT, mavlink.MAVLINK_MSG_ID_GPS2_RAW
    estimator = mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS
    assert sorted(refused) == sorted([second_gps, mavlink.MAVLINK_MSG_ID_SYS_STATUS, estimator])
    rig.wire.loses = lambda one: one.get_msgId() == gps
    rig.run(20.0)
    assert streams_requested(rig)[len(once) + len(refused) :] == [gps] * 3, "after 3, 8 and 18 s"


def test_a_late_answer_does_not_give_up_another_stream(rig: Rig) -> None:
    rig.autopilot.reboot()
    rig.wire.loses = lambda one: one.get_type() == "COMMAND_ACK"
    denied = MavlinkCodec(1, 1).encode(mavlink.MAVLink_command_ack_message(511, 2, 0, 0, 1, 191))
    rig.run(7.0)
    assert rig.pty is not None
    rig.pty.send(denied)  # not lost
    rig.run(20.0)
    assert rig.connection.vehicle.session.heard_ns.keys() >= {24, 32, 33, 74}


def flown(name: str) -> Iterator[tuple[float, Vehicle, int]]:
    """A recorded drive: seconds since its start, the vehicle, and the time."""
    vehicle, start_ns = Vehicle(), 0
    for now_ns, messages in messages_of(FLIGHTS / name / "telem2.tlog.gz"):
        start_ns = start_ns or now_ns
        for message in messages:
            vehicle.handle(message, now_ns)
        yield (now_ns - start_ns) / 1e9, vehicle, now_ns


@pytest.mark.skipif(not FLIGHTS.exists(), reason="the recorded drives are not there")
@pytest.mark.parametrize(
    ("name", "lost_s", "bounds"),
    [("night_auto_a", 42.4, False), ("px4_aided_person", 50.3, True), ("px4_failure_gps_off", 52.1, True)],
)
def test_recorded_drives(name: str, lost_s: float, bounds: bool) -> None:
    """ArduPilot flew with EK3_SRC1_POSXY 0: a good GPS that it did not use."""
    states: dict[str, set[str]] = {"before": set(), "after": set()}
    was_bound = False
    for second, vehicle, now_ns in flown(name):
        if lost_s - 8 < second < lost_s - 1:
            states["before"].add(vehicle.session.gps.state(now_ns))
            was_bound |= vehicle.session.gps.bound_m(vehicle.position(now_ns), now_ns) is not None
        elif second > lost_s + 1.5:
            states["after"].add(vehicle.session.gps.state(now_ns))
    assert states == {"before": {"healthy" if bounds else "unknown"}, "after": {"not healthy"}}
    assert was_bound == bounds


@pytest.mark.parametrize("flags", [0x33F, 0x12F], ids=["used", "not used"])
def test_gps_that_is_lost_before_the_filter_used_it_is_reported(open_rig: OpenRig, flags: int) -> None:
    """EKF3 uses a good GPS about 40 s after boot; a vehicle that sets off sooner has no known position without it."""
    rig = open_rig(emit="external_position", gates=GatesConfig(min_move_m=0.0), gps=False)
    sky = Sky(rig)
    sky.flags = flags
    sky.run(8.0)
    sky.first, sky.flags = NO_FIX, 0x12F
    sky.run(5.0)
    warning = "Lookback: GPS LOST, position unknown"
    lines = [(one.text, one.severity) for one in rig.received("STATUSTEXT")]
    assert ((warning, mavlink.MAV_SEVERITY_WARNING) in lines) == (flags != 0x33F)
    sky.offer(6.0)
    texts = [one.text for one in rig.received("STATUSTEXT")]
    assert rig.connection.why_no_position == ("" if flags == 0x33F else "not confirmed by another place yet")
    assert texts.count(warning) == (flags != 0x33F)
