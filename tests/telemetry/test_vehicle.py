"""The vehicle against recorded telemetry of ArduPilot and PX4, against noise, and against a drive made by hand."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.telemetry.codec import FusionStatus, MavlinkCodec
from edge.telemetry.link_protocol import STREAMS_HZ, StreamRequests
from edge.telemetry.session import Origin, Session
from edge.telemetry.vehicle import Vehicle
from tests.common import S
from tests.telemetry.rig import STEP_NS
from tests.telemetry.speaker import Speaker, connect
from tests.tlog import frames_of

ReadTlog = Callable[[str], Iterator[tuple[int, bytes]]]


def replay(frames: Iterator[tuple[int, bytes]], vehicle: Vehicle) -> Iterator[tuple[int, Any]]:
    """Each message with its arrival, before the vehicle has seen it."""
    codec = MavlinkCodec(1, 191)
    for now_ns, frame in frames:
        for message in codec.decode(frame):
            yield now_ns, message
            vehicle.handle(message, now_ns)
        vehicle.expire(now_ns)


def test_the_boot_clock_agrees_with_the_wall_clock_of_px4(read_tlog: ReadTlog) -> None:
    """SYSTEM_TIME pairs both clocks of the autopilot, whose wall clock was the recorder's."""
    vehicle = Vehicle()
    errors_s = []
    for now_ns, message in replay(read_tlog("px4-1.18-agp"), vehicle):
        boot_s = vehicle.boot_time_s(now_ns)
        if message.get_type() == "SYSTEM_TIME" and boot_s is not None:
            errors_s.append(boot_s - message.time_boot_ms / 1e3 - (now_ns / 1e9 - message.time_unix_usec / 1e6))
    assert len(errors_s) > 100
    assert max(map(abs, errors_s)) < 0.020


def test_the_distance_of_a_recorded_drive_is_that_of_its_wheels(read_tlog: ReadTlog) -> None:
    vehicle = Vehicle()
    wheels_m: list[tuple[int, float]] = []
    for now_ns, message in replay(read_tlog("ardurover-4.6.3-nogps"), vehicle):
        if message.get_type() == "WHEEL_DISTANCE":
            wheels_m.append((now_ns, sum(map(abs, message.distance[:2])) / 2))
    (_, first_m), (end_ns, last_m) = wheels_m[0], wheels_m[-1]
    assert last_m - first_m > 100
    assert vehicle.motion.distance_m(end_ns) == pytest.approx(last_m - first_m, rel=0.05)


def test_gps_is_healthy_until_it_is_switched_off(read_tlog: ReadTlog) -> None:
    vehicle = Vehicle()
    start_ns, healthy = 0, {}
    for now_ns, _ in replay(read_tlog("px4-1.18-agp"), vehicle):
        start_ns = start_ns or now_ns
        healthy[(now_ns - start_ns) // S] = vehicle.session.gps.state(now_ns)
    assert {healthy[second] for second in range(3, 36)} == {"healthy"}  # switched off at 36.4 s
    assert {healthy[second] for second in range(40, 119)} == {"not healthy"}


def test_a_recorded_px4_reports_that_its_filter_may_fuse_gps(read_tlog: ReadTlog) -> None:
    """Also once GPS is switched off: by then it fuses none."""
    vehicle = Vehicle()
    reports = [
        (message.intended, message.active[0], vehicle.session.gps.is_fusion_on)
        for _, message in replay(read_tlog("px4-1.18-agp"), vehicle)
        if message.get_msgId() == FusionStatus.id and vehicle.connected
    ]
    assert len(reports) > 100
    assert all(intended == [1, 1, 0, 1, 1, 1, 1, 0, 0] and is_on for intended, _, is_on in reports[1:])
    assert [reports[index][1] for index in (20, -1)] == [1, 0]


def test_one_heartbeat_is_not_a_link_and_two_too_far_apart_are_none_either() -> None:
    vehicle, speaker = Vehicle(), Speaker()
    for now_s in (0, 6, 12):
        assert not vehicle.handle(speaker.heartbeat(), now_s * S)
    assert not vehicle.connected


@pytest.mark.parametrize(
    ("speaker", "autopilot"),
    [(Speaker(255, 190), mavlink.MAV_AUTOPILOT_INVALID), (Speaker(1, 191), 8), (Speaker(1, 1), 8), (Speaker(1, 25), 3)],
)
def test_ground_stations_and_companions_are_not_the_vehicle(speaker: Speaker, autopilot: int) -> None:
    vehicle = Vehicle()
    for now_s in range(4):
        vehicle.handle(speaker.heartbeat(autopilot), now_s * S)
    assert not vehicle.connected


def test_two_vehicles_taking_turns_are_told_apart() -> None:
    vehicle, mine, other = Vehicle(), Speaker(3), Speaker(9)
    for now_s in range(3):
        vehicle.handle(mine.heartbeat(), now_s * S)
        vehicle.handle(other.heartbeat(), now_s * S)
    assert vehicle.system_id == 3
    assert not vehicle.handle(other.position(1000), 3 * S)
    assert vehicle.position(3 * S) is None
    assert vehicle.handle(mine.position(1000), 3 * S)
    assert vehicle.position(3 * S) is not None
    assert vehicle.position(6 * S) is None, "stale"


def test_a_heading_that_the_autopilot_does_not_know_is_none() -> None:
    speaker = Speaker()
    vehicle = connect(speaker)
    for boot_ms, message, heading_deg in (
        (1000, speaker.fix(1000, 0.0, 5.0, 0.0), 0.0),
        (1200, speaker.position(1200), None),
    ):
        vehicle.handle(message, 2 * S + boot_ms * 1_000_000)
        position = vehicle.position(2 * S + boot_ms * 1_000_000)
        assert position is not None
        assert position.heading_deg == heading_deg


def test_the_link_is_lost_after_five_silent_seconds_and_comes_back() -> None:
    speaker = Speaker()
    vehicle = connect(speaker)
    vehicle.expire(6 * S)
    assert vehicle.connected
    vehicle.expire(6 * S + 1)
    assert not vehicle.connected
    vehicle.handle(speaker.heartbeat(), 20 * S)
    vehicle.handle(speaker.heartbeat(), 21 * S)
    assert vehicle.connected
    assert vehicle.session.number == 2
    vehicle.reset_link()
    vehicle.handle(speaker.heartbeat(), 22 * S)
    assert not vehicle.connected, "the port was lost, and one heartbeat may be noise"


def test_a_clock_that_goes_back_is_a_reboot_but_swapped_messages_are_not() -> None:
    speaker = Speaker()
    vehicle = connect(speaker)
    for boot_ms in (500_000, 500_100, 500_050, 500_200):
        vehicle.handle(speaker.position(boot_ms), 2 * S)
    assert vehicle.session.number == 1
    for tenth in range(5):
        vehicle.handle(speaker.position(3_000 + 100 * tenth), 4 * S + tenth * S // 10)
    assert vehicle.session.number == 1, "half a second without a message of the old clock makes it sure"
    vehicle.handle(speaker.position(3_500), 4 * S + S // 2)
    assert vehicle.session.number == 2
    assert vehicle.boot_time_s(5 * S) == pytest.approx(4.0)


def test_the_clock_of_a_recorded_autopilot_is_not_known_from_its_reboot_until_it_sends_the_new_one() -> None:
    """A position was sent after its first answer to TIMESYNC, with the old clock: the next hundred came 0.5 s late."""
    vehicle, known_s = Vehicle(), []
    frames = list(frames_of(Path(__file__).with_name("reboot.tlog")))
    began_ns, codec = frames[0][0], MavlinkCodec(1, 191)
    for step_ns in range(0, 5_700_000_000, STEP_NS):
        while frames and frames[0][0] - began_ns <= step_ns:
            for message in codec.decode(frames.pop(0)[1]):
                vehicle.handle(message, began_ns + step_ns)
        vehicle.expire(began_ns + step_ns)
        if vehicle.own(began_ns + step_ns).is_clock_known:
            known_s.append(step_ns / 1e9)
    gaps_s = [one for one in pairwise(known_s) if one[1] - one[0] > 1.5 * STEP_NS / 1e9]
    assert known_s[0] == pytest.approx(1.12, abs=0.02)
    assert gaps_s == [pytest.approx((1.52, 5.0), abs=0.05)]


def test_a_clock_of_32_bits_that_begins_again_is_no_reboot() -> None:
    speaker = Speaker()
    vehicle = connect(speaker)
    for step in range(20):
        vehicle.handle(speaker.position((2**32 - 1000 + 100 * step) % 2**32), 2 * S + step * S // 10)
    assert vehicle.session.number == 1
    assert vehicle.boot_time_s(4 * S) == pytest.approx(2**32 / 1000 + 1.0, abs=0.2)


def test_distance_between_and_beyond_the_reports() -> None:
    speaker = Speaker()
    vehicle = connect(speaker)
    for boot_ms, speed_mps in ((1000, 10.0), (2000, 10.0), (3000, 20.0)):
        vehicle.handle(speaker.position(boot_ms, speed_mps), boot_ms * 1_000_000)
    assert vehicle.motion.distance_m(S // 2) is None, "before the first report"
    assert vehicle.motion.distance_m(3 * S // 2) == pytest.approx(5.0)
    assert vehicle.motion.distance_m(5 * S // 2) == pytest.approx(17.5)
    assert vehicle.motion.distance_m(7 * S // 2) == pytest.approx(35.0), "extrapolated"
    assert vehicle.motion.distance_m(5 * S) is None, "too far beyond the last report"


def test_distance_never_goes_back_when_the_vehicle_brakes() -> None:
    speaker = Speaker()
    vehicle = connect(speaker)
    vehicle.handle(speaker.position(2000, 10.0), 2 * S)
    ahead_m = vehicle.motion.distance_m(3 * S)
    vehicle.handle(speaker.position(2900, 0.0), round(2.9 * S))
    after_m = vehicle.motion.distance_m(round(3.1 * S))
    assert ahead_m == pytest.approx(10.0)
    assert after_m == ahead_m


def test_a_standing_vehicle_covers_no_distance_though_its_filter_jitters() -> None:
    speaker = Speaker()
    vehicle = connect(speaker)
    for tenth in range(20, 620):
        vehicle.handle(speaker.position(tenth * 100, 0.04), tenth * S // 10)
    assert vehicle.motion.distance_m(62 * S) == 0.0


def test_the_displacement_is_that_of_the_positions_until_one_of_ours_may_have_moved_them() -> None:
    """The filter drives north by its positions, and 3 degrees to the right of that by its velocity."""
    speaker = Speaker()
    vehicle = connect(speaker)

    def drive(first_ms: int, count: int, jump_m: float = 0.0) -> tuple[float, float]:
        begin = vehicle.motion.displacement(first_ms * 1_000_000)
        for tenth in range(1, count + 1):
            boot_ms = first_ms + 100 * tenth
            north_m = boot_ms / 100.0 + (jump_m if tenth > count // 2 else 0.0)
            vehicle.handle(speaker.fix(boot_ms, north_m, vn_mps=9.986, ve_mps=0.523), boot_ms * 1_000_000)
        end = vehicle.motion.displacement((first_ms + 100 * count) * 1_000_000)
        assert begin is not None and end is not None and begin.odometry_epoch == end.odometry_epoch
        return end.east_m - begin.east_m, end.north_m - begin.north_m

    vehicle.handle(speaker.fix(2000, 20.0, vn_mps=9.986, ve_mps=0.523), 2 * S)
    assert drive(2000, 20) == pytest.approx((0.0, 20.0), abs=0.06)
    assert drive(4000, 20, jump_m=5.0)[1] == pytest.approx(20.0, abs=0.2), "a jump is no displacement"
    vehicle.velocity.has_our_position = True
    assert drive(6000, 20) == pytest.approx((1.05, 19.97), abs=0.1)


def test_our_timesync_answers_are_taken_and_those_of_others_are_not() -> None:
    speaker = Speaker()
    vehicle = connect(speaker)
    vehicle.handle(speaker.fix(101_900, 0.0, vn_mps=0.0, ve_mps=0.0), 2 * S)
    for sent_ns in range(2 * S, 8 * S, S // 2):
        vehicle.session.clock.requested(sent_ns)
        answer = speaker.say(mavlink.MAVLink_timesync_message(sent_ns + 2_000_000 + 100 * S, sent_ns))
        vehicle.handle(answer, sent_ns + 4_000_000)
        stranger = speaker.say(mavlink.MAVLink_timesync_message(sent_ns + 130 * S, sent_ns - 1))
        vehicle.handle(stranger, sent_ns + 5_000_000)
    assert vehicle.boot_time_s(8 * S) == pytest.approx(108.0, abs=0.001)


def test_the_autopilots_own_timesync_requests_tell_its_time() -> None:
    speaker = Speaker()
    vehicle = connect(speaker)
    vehicle.handle(speaker.fix(76_900, 0.0, vn_mps=0.0, ve_mps=0.0), 2 * S)
    vehicle.handle(speaker.say(mavlink.MAVLink_timesync_message(0, 77 * S)), 2 * S)
    assert vehicle.boot_time_s(3 * S) == pytest.approx(78.0)


def test_the_recorded_rover_tells_its_origin_and_px4_its_accuracy(read_tlog: ReadTlog) -> None:
    rover, px4, accuracies_m = Vehicle(), Vehicle(), []
    for _ in replay(read_tlog("ardurover-4.6.3-nogps"), rover):
        pass
    origin = rover.session.origin
    assert origin is not None
    assert (origin.lat_deg, origin.lon_deg) == pytest.approx((-35.363262, 149.165237))
    assert origin.alt_m == pytest.approx(584.0)
    for now_ns, message in replay(read_tlog("px4-1.18-agp"), px4):
        if message.get_type() == "ESTIMATOR_STATUS" and px4.accuracy_m(now_ns) is not None:
            accuracies_m.append(px4.accuracy_m(now_ns))
    assert len(accuracies_m) > 100
    assert rover.accuracy_m(0) is None


def test_the_distance_by_wheels_alone(read_tlog: ReadTlog) -> None:
    whole, wheels = Vehicle(), Vehicle()
    end_ns = 0
    for end_ns, message in replay(read_tlog("ardurover-4.6.3-nogps"), whole):
        if message.get_type() in ("HEARTBEAT", "WHEEL_DISTANCE"):
            wheels.handle(message, end_ns)
    assert wheels.motion.distance_m(end_ns) == pytest.approx(whole.motion.distance_m(end_ns), rel=0.06)


def test_wheels_that_turn_against_each_other_turn_the_vehicle_on_the_spot() -> None:
    speaker = Speaker()
    vehicle = connect(speaker)
    for tenth in range(20, 60):
        distances_m = [0.1 * tenth, -0.1 * tenth] + [0.0] * 14
        message = speaker.say(mavlink.MAVLink_wheel_distance_message(tenth * 100_000, 2, distances_m))
        vehicle.handle(message, tenth * S // 10)
    assert vehicle.motion.distance_m(6 * S - S // 10) == 0.0


def test_version_origin_and_accuracy_are_forgotten_where_a_reboot_changes_them() -> None:
    speaker = Speaker()
    vehicle = connect(speaker)
    version = mavlink.MAVLink_autopilot_version_message(
        0, 1 << 24 | 18 << 16 | 255, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, 0
    )
    vehicle.handle(speaker.say(version), 2 * S)
    vehicle.handle(speaker.say(mavlink.MAVLink_gps_global_origin_message(10, 20, 30_000)), 2 * S)
    vehicle.handle(speaker.say(mavlink.MAVLink_estimator_status_message(0, 0, 0, 0, 0, 0, 0, 0, 4.5, 1)), 2 * S)
    assert vehicle.session.version == (1, 18)
    assert vehicle.session.origin == Origin(1e-6, 2e-6, 30.0)
    assert vehicle.accuracy_m(5 * S) == 4.5
    assert vehicle.accuracy_m(5 * S + 1) is None, "stale"
    vehicle.handle(speaker.position(500_000), 3 * S)
    for now_ns in (3 * S, 3 * S + S // 2):
        vehicle.handle(speaker.position(now_ns // 1_000_000), now_ns)
    assert vehicle.session.origin is None and vehicle.session.version is None
    assert vehicle.accuracy_m(3 * S) is None


def test_a_stream_that_is_refused_twice_is_given_up() -> None:
    requests, asked = StreamRequests(Session()), Counter[int]()
    for now_ns in range(S, 1000 * S, S):
        for message in requests.due(1, now_ns):
            asked[int(message.param1)] += 1
            requests.read_acknowledgement(mavlink.MAV_RESULT_UNSUPPORTED)
    assert asked == dict.fromkeys(STREAMS_HZ, 2)
