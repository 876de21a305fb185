"""Signing: keys, the timestamp over restarts, frames that are refused, and a link that is signed at both ends."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.errors import ConfigError
from edge.journal.records import FixAnswered
from edge.telemetry import encoders
from edge.telemetry.codec import MavlinkCodec
from edge.telemetry.signing import EPOCH_S, STORED_AHEAD, TICKS_PER_S, Signer, load_key

KEY = hashlib.sha256(b"a passphrase").digest()
OTHER = hashlib.sha256(b"another one").digest()
NOW_S = 1_800_000_000.0
YEARS_S = 1e8
BEAT = encoders.heartbeat(4)


def codec(folder: Path, name: str, key: bytes = KEY, now_s: float = NOW_S) -> MavlinkCodec:
    return MavlinkCodec(1, 1 if name == "theirs" else 191, Signer(key, folder / name, 0, lambda: now_s))


def keyed(folder: Path) -> dict[str, str]:
    """What a config says of signing with this key."""
    (folder / "key").write_bytes(KEY)
    (folder / "key").chmod(0o600)
    return {"signing_key": str(folder / "key"), "signing_clock": str(folder / "clock")}


def stamp_of(frame: bytes) -> int:
    return int.from_bytes(frame[-12:-6], "little")


@pytest.mark.parametrize("text", [KEY, KEY.hex().encode(), KEY.hex().encode() + b"\n"])
def test_a_key_is_32_bytes_or_their_digits(tmp_path: Path, text: bytes) -> None:
    file = tmp_path / "key"
    file.write_bytes(text)
    file.chmod(0o600)
    assert load_key(str(file)) == KEY


@pytest.mark.parametrize(
    ("text", "mode", "reason"),
    [
        (KEY, 0o640, "other users can read this key; chmod 600"),
        (b"short", 0o600, "not a key of 32 bytes"),
        (None, 0, "cannot read this key: No such file"),
    ],
)
def test_a_key_that_is_refused(tmp_path: Path, text: bytes | None, mode: int, reason: str) -> None:
    file = tmp_path / "key"
    if text is not None:
        file.write_bytes(text)
        file.chmod(mode)
    with pytest.raises(ConfigError, match=rf"^\[telemetry\] signing_key: {file}: {reason}"):
        load_key(str(file))


def test_a_credential_of_systemd(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("CREDENTIALS_DIRECTORY", raising=False)
    with pytest.raises(ConfigError, match="LoadCredential="):
        load_key("credential:mavlink")
    (tmp_path / "mavlink").write_bytes(KEY)
    (tmp_path / "mavlink").chmod(0o440)  # as systemd has it
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(tmp_path))
    assert load_key("credential:mavlink") == KEY
    with pytest.raises(ConfigError, match="must not contain /"):
        load_key("credential:../mavlink")


def test_signed_frames_are_understood_and_others_are_not(tmp_path: Path) -> None:
    ours, theirs = codec(tmp_path, "ours"), codec(tmp_path, "theirs")
    frame = theirs.encode(BEAT)
    altered = bytearray(frame)
    altered[14] ^= 1
    assert [message.get_type() for message in ours.decode(frame)] == ["HEARTBEAT"]
    assert not ours.awaits_signed
    assert not ours.decode(frame), "replayed"
    assert not ours.decode(MavlinkCodec(1, 1).encode(BEAT)), "unsigned"
    assert not ours.decode(codec(tmp_path, "theirs", OTHER).encode(BEAT)), "another's key"
    assert not ours.decode(bytes(altered)), "altered"
    assert ours.decode(theirs.encode(BEAT)), "and a good one still is"


def test_a_forged_frame_from_the_future_does_not_lock_the_real_sender_out(tmp_path: Path) -> None:
    ours, theirs = codec(tmp_path, "ours"), codec(tmp_path, "theirs")
    forged = codec(tmp_path, "forger", OTHER, NOW_S + 1e6)
    forged.component_id = 1
    assert ours.decode(theirs.encode(BEAT))
    frame = bytearray(forged.encode(BEAT))
    frame[6] = 1  # as if from component 1; the signature is wrong anyway
    assert not ours.decode(bytes(frame))
    assert ours.decode(theirs.encode(BEAT))


@pytest.mark.parametrize("noise", [b"", b"\x01"], ids=["in step", "out of step"])
def test_frames_whose_timestamps_look_like_a_beginning_are_read_soon(tmp_path: Path, noise: bytes) -> None:
    """0xFE 24 begins a frame of 32 bytes, ours have 34: after the first cut one all begin within their timestamps."""
    now = int.from_bytes(bytes.fromhex("80fe18222200"), "little")
    ours = MavlinkCodec(1, 191, Signer(KEY, tmp_path / "ours", 0, lambda: EPOCH_S + now / TICKS_PER_S))
    theirs = MavlinkCodec(1, 1, Signer(KEY, tmp_path / "theirs", 0, lambda: EPOCH_S + now / TICKS_PER_S))
    cut = theirs.encode(BEAT)
    assert ours.decode(noise + cut[-11:]) == []
    assert cut[-11:-9] == b"\xfe\x18"
    assert any(ours.decode(theirs.encode(BEAT)) for _ in range(15))


def test_timestamps_only_grow_over_a_restart_and_a_clock_that_was_set_back(tmp_path: Path) -> None:
    first = stamp_of(codec(tmp_path, "ours").encode(BEAT))
    assert first == pytest.approx((NOW_S - EPOCH_S) * TICKS_PER_S, abs=1)
    restarted = codec(tmp_path, "ours", now_s=NOW_S - 3600)
    second, third = stamp_of(restarted.encode(BEAT)), stamp_of(restarted.encode(BEAT))
    assert first < second < third <= first + 2 * STORED_AHEAD


def test_a_damaged_or_unwritable_timestamp_costs_nothing_but_the_memory(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "ours").write_bytes(b"\xffnonsense")
    assert codec(tmp_path, "ours").encode(BEAT)
    signer = Signer(KEY, tmp_path / "missing" / "folder", 0, lambda: NOW_S)
    assert MavlinkCodec(1, 191, signer).encode(BEAT)
    assert "cannot write it" in caplog.text


def test_we_run_ahead_with_a_peer_that_does(tmp_path: Path) -> None:
    ours, ahead = codec(tmp_path, "ours"), codec(tmp_path, "theirs", now_s=NOW_S + 50)
    assert ours.decode(ahead.encode(BEAT))
    assert stamp_of(ours.encode(BEAT)) > (NOW_S + 49 - EPOCH_S) * TICKS_PER_S


def test_after_a_crash_nothing_is_taken_twice_and_who_is_past_what_was_kept_is_heard(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    now_s = NOW_S
    theirs = MavlinkCodec(1, 1, Signer(KEY, tmp_path / "theirs", 0, lambda: now_s))
    crashed = codec(tmp_path, "ours")
    frames = []
    for _ in range(25):
        now_s += 1.0
        frames.append(theirs.encode(BEAT))
        assert crashed.decode(frames[-1])
    restarted = codec(tmp_path, "ours")
    assert not any(restarted.decode(frame) for frame in frames)
    assert caplog.text.count("its timestamp is not new") == 1
    heard_after_s = 0.0
    while not restarted.decode(theirs.encode(BEAT)):
        heard_after_s, now_s = heard_after_s + 0.1, now_s + 0.1
    assert heard_after_s <= STORED_AHEAD / TICKS_PER_S + 0.1


def test_after_an_end_the_next_frame_is_heard_and_none_before_it(tmp_path: Path) -> None:
    theirs, ours = codec(tmp_path, "theirs"), codec(tmp_path, "ours")
    frame = theirs.encode(BEAT)
    assert ours.decode(frame)
    last = stamp_of(ours.encode(BEAT))
    ours.store_timestamps()
    restarted = codec(tmp_path, "ours", now_s=NOW_S - 3600)
    assert last < stamp_of(restarted.encode(BEAT)) <= last + 2
    assert not restarted.decode(frame)
    assert restarted.decode(theirs.encode(BEAT))


@pytest.mark.parametrize("damage", [b"\xffnonsense", b"{}x", b"12"])
def test_a_damaged_file_is_reported(tmp_path: Path, caplog: pytest.LogCaptureFixture, damage: bytes) -> None:
    (tmp_path / "ours").write_bytes(damage)
    assert codec(tmp_path, "ours").decode(codec(tmp_path, "theirs").encode(BEAT))
    assert f"{tmp_path / 'ours'}: ignored" in caplog.text


@pytest.mark.parametrize(("key", "up"), [(KEY, True), (OTHER, False)])
def test_a_signed_link(tmp_path: Path, open_rig: Callable[..., Any], key: bytes, up: bool) -> None:
    config = keyed(tmp_path)
    theirs = codec(tmp_path, "theirs", key, now_s=time.time())
    rig = open_rig(emit="external_position", gps=False, config=config, codec=theirs)
    assert rig.run(0.8) is False
    rig.run(6.0)
    assert (rig.connection.state == "up") is up
    if up:
        assert rig.received("HEARTBEAT")
        assert rig.send_position(rig.fix())
        rig.run(0.5)
        assert rig.journalled(FixAnswered)[-1].result == "ACCEPTED"
    else:
        assert not rig.received("HEARTBEAT"), "and what we sign is nothing to a peer with another key"
    assert (tmp_path / "clock.0").exists()


def test_the_peer_is_heard_before_anything_is_signed(tmp_path: Path, open_rig: Callable[..., Any]) -> None:
    """Its clock may be ahead of ours, and it would drop what is older than what it knows."""
    config = keyed(tmp_path)
    rigs: list[Any] = []
    ahead = Signer(KEY, tmp_path / "theirs", 0, lambda: 4_000_000_000.0 + (rigs[0].now_ns / 1e9 if rigs else 0.0))
    rigs.append(rig := open_rig(config=config, codec=MavlinkCodec(1, 1, ahead)))
    heard = rig.run(8.0, lambda: bool(rig.received("HEARTBEAT")))
    assert heard
    assert stamp_of(rig.connection._port.codec.encode(BEAT)) > (4_000_000_000 - EPOCH_S) * TICKS_PER_S


def test_what_was_recorded_over_a_minute_ago_begins_no_stream(tmp_path: Path) -> None:
    recorded = codec(tmp_path, "theirs").encode(BEAT)
    assert not codec(tmp_path, "late", now_s=NOW_S + 61).decode(recorded)
    assert codec(tmp_path, "soon", now_s=NOW_S + 59).decode(recorded)


def test_what_another_link_carried_is_not_heard_beside_the_sender(tmp_path: Path) -> None:
    """The radio of a ground station: the same autopilot and key, but a link of its own."""
    recorded = MavlinkCodec(1, 1, Signer(KEY, tmp_path / "radio", 1, lambda: NOW_S - 30.0)).encode(BEAT)
    ours, theirs = codec(tmp_path, "ours"), codec(tmp_path, "theirs")
    assert ours.decode(theirs.encode(BEAT))
    assert not ours.decode(recorded)
    assert ours.decode(theirs.encode(BEAT))


def test_a_recording_that_is_played_slowly_is_heard_for_a_minute(tmp_path: Path) -> None:
    """At half speed, beginning with the newest frame: pymavlink alone follows it for good."""
    began_s = now_s = NOW_S
    ours = MavlinkCodec(1, 191, Signer(KEY, tmp_path / "ours", 0, lambda: now_s))
    theirs = MavlinkCodec(1, 1, Signer(KEY, tmp_path / "theirs", 0, lambda: began_s + (now_s - began_s) / 2))
    heard_s = []
    for now_s in range(round(NOW_S), round(NOW_S) + 300):
        if ours.decode(theirs.encode(BEAT)):
            heard_s.append(now_s - began_s)
    assert heard_s == list(range(121))


def test_a_recording_of_years_ahead_moves_nothing(tmp_path: Path, open_rig: Callable[..., Any]) -> None:
    """Of a drive whose GPS had a wrong date. Such frames are followed: an autopilot whose GPS is spoofed would not be
    heard otherwise, and each boot of ArduPilot adds a minute. But it hears our date in turn, and goes on after them.
    """
    config = keyed(tmp_path)
    theirs = codec(tmp_path, "theirs", now_s=time.time())
    rig = open_rig(emit="external_position", gps=False, config=config, codec=theirs)
    rig.run(6.0)
    recorded = codec(tmp_path, "future", now_s=time.time() + YEARS_S)
    recorded.component_id = 1
    sent = []
    for second in range(20):
        boot_ms, lat = 400_000 + 1000 * second, -280_000_000
        for message in (
            mavlink.MAVLink_global_position_int_message(boot_ms, lat, 1_530_000_000, 0, 0, 9900, 0, 0, 0),
            mavlink.MAVLink_gps_raw_int_message(boot_ms * 1000, 3, lat, 1_530_000_000, 0, 80, 100, 9900, 0, 12),
            BEAT,
        ):
            rig.wire.send(recorded.encode(message))
        rig.run(1.0)
        sent.append(rig.send_position(rig.fix()))
        assert (rig.position.lat_deg, rig.position.lon_deg) == pytest.approx(rig.true_position(0.0), abs=1e-4)
    assert stamp_of(rig.connection._port.codec.encode(BEAT)) > (time.time() + YEARS_S / 2 - EPOCH_S) * TICKS_PER_S
    assert rig.connection.state == "up"
    assert all(sent)


def test_a_computer_without_a_clock_hears_its_peer_and_goes_on_in_its_time(tmp_path: Path) -> None:
    ours = codec(tmp_path, "ours", now_s=EPOCH_S + 1e6)
    assert ours.decode(codec(tmp_path, "theirs").encode(BEAT))
    assert stamp_of(ours.encode(BEAT)) >= (NOW_S - EPOCH_S) * TICKS_PER_S
