"""Each message that we send, encoded and decoded again."""

from __future__ import annotations

import math
import tracemalloc
from typing import Any

import pytest
from msgspec.structs import replace
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.localization import PlaceFix, ProtectionLevel
from edge.telemetry import encoders
from edge.telemetry.codec import MavlinkCodec
from edge.telemetry.encoders import MessageContext
from edge.telemetry.firmware import firmware_of

FIX = PlaceFix(1, 1207, -27.4772001, 153.0283002, 182.5, 7.2, 2.1, "reverse", "swapped", 1.234, confidence=0.87)
SENDING = MessageContext(5, 12345.678, 0.42, 3)


def carried(message: Any) -> Any:
    """The message as it arrives, on a link on which it is the only one."""
    (received,) = MavlinkCodec(1, 1).decode(MavlinkCodec(5, 191).encode(message))
    assert (received.get_srcSystem(), received.get_srcComponent()) == (5, 191)
    return received


@pytest.mark.parametrize(
    "change",
    [
        {"lat_deg": None},
        {"lon_deg": None},
        {"lat_deg": math.nan},
        {"lon_deg": math.inf},
        {"lat_deg": 90.1},
        {"sigma_along_m": math.inf},
        {"sigma_along_m": math.nan},
        {"sigma_cross_track_m": math.nan},
        {"sigma_along_m": 0.0},
    ],
)
@pytest.mark.parametrize("encode", [encoders.external_position, encoders.global_position_sensor])
def test_a_fix_that_must_not_become_a_position(encode: Any, change: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="finite sigma"):
        encode(replace(FIX, **change), SENDING)


@pytest.mark.parametrize("sending", [MessageContext(5, math.nan, 0.42), MessageContext(5, 12345.678, math.inf)])
def test_a_position_without_its_time_is_not_sent(sending: MessageContext) -> None:
    with pytest.raises(ValueError, match="finite times"):
        encoders.external_position(FIX, sending)


def test_a_fix_fits_into_one_status_text() -> None:
    of_tile = replace(FIX, map="tile-3", place=7)
    assert encoders.describe(of_tile) == "Place 7 of tile-3 backwards, confidence 0.87"
    text = encoders.describe(FIX)
    assert text == "Place 1207 backwards, confidence 0.87"
    assert len(encoders.status_text(text, 6)) == 1


@pytest.mark.parametrize(
    ("text", "lines"),
    [
        ("x" * 50, ["x" * 50]),
        (
            "Lookback degraded: not recognized: camera: the picture is black",
            ["Lookback degraded: not recognized: camera: the", "picture is black"],
        ),
        ("/a" * 30, ["/a" * 25, "/a" * 5]),
    ],
)
def test_a_status_text_is_lines_of_complete_words(text: str, lines: list[str]) -> None:
    sent = [carried(message) for message in encoders.status_text(text, mavlink.MAV_SEVERITY_NOTICE)]
    assert [one.text for one in sent] == lines
    assert {(one.severity, one.id, one.chunk_seq) for one in sent} == {(5, 0, 0)}


def test_a_protection_level_that_nothing_bounds_is_a_large_number() -> None:
    for level, expected in ((ProtectionLevel(12.5, math.inf), (12.5, 1e6)), (None, (1e6, 1e6))):
        messages = [carried(message) for message in encoders.protection_values(level, 2**32 + 5)]
        assert [one.name for one in messages] == ["pl_along", "pl_across"]
        assert tuple(one.value for one in messages) == expected
        assert {one.time_boot_ms for one in messages} == {5}


def test_frames_cut_anywhere_arrive_whole() -> None:
    sender, receiver = MavlinkCodec(1, 191), MavlinkCodec(1, 1)
    frames = b"".join(sender.encode(encoders.external_position(FIX, SENDING)) for _ in range(20))
    cut = [message for start in range(0, len(frames), 7) for message in receiver.decode(frames[start : start + 7])]
    assert len(cut) == 20


def test_reads_that_never_end_with_a_frame_do_not_pile_up() -> None:
    sender, receiver = MavlinkCodec(1, 1), MavlinkCodec(1, 191)
    frames = b"".join(sender.encode(encoders.heartbeat(4)) for _ in range(8_000))
    receiver.decode(frames[:5])
    tracemalloc.start()
    for start in range(5, len(frames) - 210, 210):
        receiver.decode(frames[start : start + 210])
    _, peak_bytes = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak_bytes < len(frames) / 2


def test_messages_that_the_dialect_does_not_know_are_left_out() -> None:
    unknown = bytes([0xFD, 1, 0, 0, 0, 1, 1, 0xFF, 0xFF, 0x0F, 42, 0, 0])
    beat = MavlinkCodec(1, 1).encode(encoders.heartbeat(4))
    assert [message.get_type() for message in MavlinkCodec(1, 191).decode(unknown + beat)] == ["HEARTBEAT"]


def test_lines_about_the_message_of_a_firmware_are_one_status_text() -> None:
    for autopilot in (3, 12, 8):
        for version, all_came in ((None, True), ((1, 14), True), ((1, 18), True), ((4, 4), True), ((4, 10), False)):
            _, why = firmware_of(autopilot).suitable(version, {"VISO_TYPE": 1.0}, all_came=all_came)
            assert len(encoders.status_text(f"Lookback: {why}", mavlink.MAV_SEVERITY_WARNING)) == 1, why
