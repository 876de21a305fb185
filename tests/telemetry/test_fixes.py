"""Each message that we send, encoded and decoded again."""

from __future__ import annotations

import math
import tracemalloc
from typing import Any

import pytest
from msgspec.structs import replace
from pymavlink.dialects.v20 import common as mavlink

from edge.telemetry import PlaceFix, fixes
from edge.telemetry.codec import MavlinkCodec

FIX = PlaceFix(1, 1207, -27.4772001, 153.0283002, 182.5, 7.5, "reverse", "swapped", 1.234, "residential_street")


def carried(message: Any) -> Any:
    """The message as it arrives, on a link on which it is the only one."""
    (received,) = MavlinkCodec(1, 1).decode(MavlinkCodec(5, 191).encode(message))
    assert (received.get_srcSystem(), received.get_srcComponent()) == (5, 191)
    return received


def test_heartbeat() -> None:
    message = carried(fixes.heartbeat(mavlink.MAV_STATE_ACTIVE))
    assert (message.type, message.autopilot, message.system_status) == (18, 8, 4)


def test_external_position() -> None:
    message = carried(fixes.external_position(FIX, 5, 12345.678, 0.42))
    assert message.get_type() == "COMMAND_INT"
    assert (message.target_system, message.target_component) == (5, 1)
    assert (message.command, message.frame) == (43003, 0)
    assert (message.x, message.y) == (-274772001, 1530283002)
    assert math.isnan(message.z)
    assert (message.param1, message.param2, message.param3) == pytest.approx((12345.678, 0.42, 7.5), rel=1e-6)


@pytest.mark.parametrize("change", [{"lat_deg": None}, {"lon_deg": None}, {"sigma_m": math.inf}, {"sigma_m": math.nan}])
def test_a_fix_that_must_not_become_a_position(change: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="finite sigma"):
        fixes.external_position(replace(FIX, **change), 1, 1.0, 0.1)


def test_a_fix_fits_into_one_status_text() -> None:
    text = fixes.describe(FIX)
    assert text == "Place 1207 backwards, residential_street, 1.23"
    assert len(fixes.status_text(text, 6, 1)) == 1


@pytest.mark.parametrize("size", [0, 1, 49, 50, 51, 99, 100, 101, 250])
def test_status_text_of_any_length(size: int) -> None:
    text = ("abcdefghij" * 25)[:size]
    chunks = [carried(message) for message in fixes.status_text(text, mavlink.MAV_SEVERITY_NOTICE, 77)]
    assert "".join(chunk.text for chunk in chunks) == text
    assert {chunk.severity for chunk in chunks} == {5}
    if size <= 50:
        assert [(chunk.id, chunk.chunk_seq) for chunk in chunks] == [(0, 0)]
    else:
        assert [(chunk.id, chunk.chunk_seq) for chunk in chunks] == [(77, index) for index in range(len(chunks))]
        assert len(chunks[-1].text) < 50, "the last chunk ends with a null byte"


def test_named_value() -> None:
    message = carried(fixes.uniqueness_value(FIX, 2**32 + 5))
    assert (message.name, message.time_boot_ms) == ("uniqueness", 5)
    assert message.value == pytest.approx(1.234)


def test_stream_request_and_timesync() -> None:
    request = carried(fixes.stream_request(5, 33, 10.0))
    assert (request.command, request.param1, request.param2) == (511, 33, 100_000)
    assert (request.target_system, request.target_component) == (5, 1)
    theirs = carried(fixes.timesync_request(123))
    answer = carried(fixes.timesync_answer(theirs, 456))
    assert (theirs.tc1, theirs.ts1, answer.tc1, answer.ts1) == (0, 123, 456, 123)


def test_sequence_numbers_count_up_and_wrap() -> None:
    sender, receiver = MavlinkCodec(1, 191), MavlinkCodec(1, 1)
    frames = b"".join(sender.encode(fixes.heartbeat(4)) for _ in range(300))
    assert [message.get_seq() for message in receiver.decode(frames)] == [index % 256 for index in range(300)]


def test_frames_cut_anywhere_arrive_whole() -> None:
    sender, receiver = MavlinkCodec(1, 191), MavlinkCodec(1, 1)
    frames = b"".join(sender.encode(fixes.external_position(FIX, 1, 1.0, 0.1)) for _ in range(20))
    cut = [message for start in range(0, len(frames), 7) for message in receiver.decode(frames[start : start + 7])]
    assert len(cut) == 20


def test_reads_that_never_end_with_a_frame_do_not_pile_up() -> None:
    sender, receiver = MavlinkCodec(1, 1), MavlinkCodec(1, 191)
    frames = b"".join(sender.encode(fixes.heartbeat(4)) for _ in range(8_000))
    receiver.decode(frames[:5])
    tracemalloc.start()
    for start in range(5, len(frames) - 210, 210):
        receiver.decode(frames[start : start + 210])
    _, peak_bytes = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak_bytes < len(frames) / 2


def test_messages_that_the_dialect_does_not_know_are_left_out() -> None:
    unknown = bytes([0xFD, 1, 0, 0, 0, 1, 1, 0xFF, 0xFF, 0x0F, 42, 0, 0])
    beat = MavlinkCodec(1, 1).encode(fixes.heartbeat(4))
    assert [message.get_type() for message in MavlinkCodec(1, 191).decode(unknown + beat)] == ["HEARTBEAT"]
