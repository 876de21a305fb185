"""`lookback doctor` against a simulated autopilot on a pty, and with each thing missing in turn."""

from __future__ import annotations

import json
import os
import struct
import threading
from collections.abc import Callable, Iterator
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import tomli_w
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.__main__ import main
from edge.feed import read_feed
from edge.journal.journal import Journal
from edge.journal.records import CameraDiffers, StateChanged
from edge.reference_map import open_map
from edge.telemetry.firmware import AIRSPEED, FLOW
from edge.telemetry.firmware import WHEELS as WHEEL_ENCODERS
from edge_plugins.doctor.command import examine
from edge_plugins.doctor.findings import Finding
from edge_plugins.doctor.fused import judge, wanted
from edge_plugins.mapping.keypoint_rows import keypoints_key
from sim.maps.adding_keypoints import add_keypoints
from sim.vehicle.autopilot import SimulatedAutopilot
from sim.vehicle.command import straight_line
from sim.vehicle.estimator import OdometryErrors
from sim.vehicle.pty_link import PtyLink, open_pty
from tests.firmware_config.test_parameter_files import FILES, by_name

ARDUPILOT = {
    "AHRS_EKF_TYPE": 3.0, "AHRS_OPTIONS": 0.0, "ARMING_CHECK": 1.0, "FLOW_TYPE": 0.0, "VISO_TYPE": 0.0,
    "EK3_SRC1_POSXY": 3.0, "EK3_SRC1_VELXY": 3.0, "EK3_SRC2_POSXY": 0.0, "EK3_SRC2_VELXY": 0.0,
    "WENC_TYPE": 0.0, "WENC_POS_Y": 0.0, "WENC_RADIUS": 0.05, "WENC_CPR": 3200.0,
}  # fmt: skip
PX4 = (
    *(f"EKF2_{name}_CTRL" for name in ("AGP0", "EV", "OF", "OF0")),
    "EKF2_AGP0_ID",
    "EKF2_GPS_MODE",
    "EKF2_NOAID_TOUT",
)
DEFAULTS = {
    "ardupilot": {name: (value, mavlink.MAV_PARAM_TYPE_REAL32) for name, value in ARDUPILOT.items()},
    "px4": dict.fromkeys(PX4, (0.0, mavlink.MAV_PARAM_TYPE_INT32)),
}
"""What a test does not set is answered as well, as by a real autopilot, so that doctor need not wait for it."""
Diagnose = Callable[..., Callable[[str, str], str]]
WHEELS = {"EK3_SRC1_VELXY": 7.0, "WENC_TYPE": 1.0, "WENC_POS_Y": -0.2, "WENC_RADIUS": 0.1, "WENC_CPR": 3200.0}


@pytest.fixture
def fly() -> Iterator[Callable[..., str]]:
    """Starts a simulated autopilot with some parameters; gives the connection to it."""
    stop = threading.Event()
    threads: list[threading.Thread] = []
    links: list[PtyLink] = []

    def start(
        parameters: dict[str, tuple[float, int]], firmware: str = "ardupilot", source_set: int = 1, **errors: Any
    ) -> str:
        links.append(open_pty())
        autopilot = SimulatedAutopilot(links[-1], straight_line(5.0, 0.0, 0.0), firmware=firmware, **errors)
        autopilot.parameters = DEFAULTS[firmware.partition("-")[0]] | parameters
        autopilot.inputs.source_set = source_set
        threads.append(threading.Thread(target=autopilot.run, args=(stop,)))
        threads[-1].start()
        return f"serial:{links[-1].device}:921600"

    yield start
    stop.set()
    for thread in threads:
        thread.join()
    for link in links:
        link.close()


@pytest.fixture(scope="module")
def street(make_street: Callable[..., Path]) -> Path:
    return make_street()


@pytest.fixture
def write_config(street: Path, tmp_path: Path) -> Callable[..., Path]:
    def write(**sections: dict[str, Any]) -> Path:
        config: dict[str, dict[str, Any]] = {
            "camera": {"kind": "feed", "device": str(street / "feed"), "fov_deg": 80.0},
            "map": {"path": str(street / "map")},
            "telemetry": {"connection": f"serial:{tmp_path}/none:57600", "journal": str(tmp_path / "events.jsonl")},
        }
        for name, keys in sections.items():
            config.setdefault(name, {}).update(keys)
        (tmp_path / "lookback.toml").write_text(tomli_w.dumps(config))
        return tmp_path / "lookback.toml"

    return write


def told(findings: list[Finding], what: str, level: str) -> str:
    """The words of all findings of that kind, with what to do."""
    return " | ".join(f"{one.words} -> {one.remedy}" for one in findings if (one.what, one.level) == (what, level))


@pytest.fixture
def diagnose(fly: Callable[..., str], write_config: Callable[..., Path], tmp_path: Path) -> Diagnose:
    """Examines an autopilot with some parameters, and a config with some sections; gives `told` of what is found."""

    def examined(
        values: dict[str, float],
        firmware: str = "ardupilot",
        *,
        emit: str = "auto",
        wait_s: float = 5.0,
        sections: dict[str, Any] | None = None,
        kind: int = mavlink.MAV_PARAM_TYPE_REAL32,
        **options: Any,
    ) -> Callable[[str, str], str]:
        connection = fly({name: (value, kind) for name, value in values.items()}, firmware, **options)
        config = write_config(telemetry={"connection": connection, "emit": emit}, **(sections or {}))
        return partial(told, list(examine(config, wait_s, tmp_path / "dev")))

    return examined  # fmt: skip


def test_all_is_well(diagnose: Diagnose) -> None:
    values = {"AHRS_EKF_TYPE": 3.0, "AHRS_OPTIONS": 7.0, "EK3_SRC1_POSXY": 3.0, **WHEELS}
    found = diagnose(values, emit="external_position", sections={"motion": {"use": "report"}})
    assert not any(found(what, "bad") for what in ("autopilot", "parameter", "map", "camera", "model", "motion"))
    for what, words in (
        ("autopilot", "ArduPilot 4."),
        ("autopilot", "texts are shown as of system 1; the values"),
        ("parameter", "AHRS_OPTIONS = 7"),
        ("parameter", "EK3_SRC1_POSXY = 3, GPS"),
        ("parameter", "WENC_POS_Y = -0.2"),
        ("autopilot", "velocity without GPS: wheel encoders"),
        ("map", "80 places, all checksums match"),
        ("camera", "160 x 120 pixels"),
        ("model", "two regions take"),
        ("motion", "30 % of the picture are ground"),
        ("motion", "speeds up to 36 m/s"),
    ):
        assert words in found(what, "good")
    assert "height is not known yet -> drive 40 m with GPS" in found("motion", "note")


@pytest.mark.parametrize(
    ("drives", "level", "words"),
    [
        ("[-0.029,0.004,0.1],[-0.028,0.004,0.1]", "good", "wheels: -2.9 % +- 1.8, by 2 drives"),
        ("[-0.029,0.004],[-0.029,0.004,0.1]", "note", "known only when two drives agree -> drive another 100 m"),
    ],
)
def test_what_earlier_drives_found_of_the_wheels(
    drives: str, level: str, words: str, diagnose: Diagnose, tmp_path: Path
) -> None:
    (tmp_path / "events.wheels").write_text('{"drives":{"1":[' + drives + "]}}")
    assert words in diagnose(WHEELS)("autopilot", level)


@pytest.mark.parametrize(
    ("emit", "values", "words"),
    [
        ("auto", {"AHRS_EKF_TYPE": 3.0, "AHRS_OPTIONS": 0.0}, "AHRS_OPTIONS = 0: else a rover"),
        ("auto", {"AHRS_EKF_TYPE": 3.0, "AHRS_OPTIONS": 0.0}, "set its bits 3"),
        ("global_position_sensor", {"EK3_OPTIONS": 0.0}, "EK3_OPTIONS = 0: message 296 is fused by builds with"),
        ("global_position_sensor", {"AHRS_OPTIONS": 0.0}, "set its bits 3"),
        (
            "external_position",
            {"EK3_SRC1_POSXY": 0.0, **WHEELS},
            "EK3_SRC1_POSXY = 0: the autopilot ignores its GPS, which works, and drifts from it -> set it to 3",
        ),
        (
            "external_position",
            {**WHEELS, "WENC_POS_Y": 0.0},
            "WENC_POS_Y = 0: wheel encoders give no speed with 0 -> measure it",
        ),
        (
            "external_position",
            {"EK3_SRC1_VELXY": 3.0},
            "no velocity aid: without GPS the autopilot cannot hold its position between fixes -> fit wheel encoders",
        ),
        (
            "external_position",
            {"EK3_SRC1_VELXY": 7.0, "WENC_TYPE": 0.0},
            "no velocity aid: without GPS the autopilot cannot hold its position between fixes",
        ),
    ],
)
def test_parameters_that_do_not_fit_are_named(diagnose: Diagnose, emit: str, values: Any, words: str) -> None:
    found = diagnose(values, emit=emit)
    assert words in f"{found('parameter', 'bad')} | {found('autopilot', 'bad')}"


FUSED = by_name(FILES / "ardupilot_rover_fused.param")


@pytest.mark.parametrize(
    ("changed", "level", "words"),
    [
        ({}, "good", "keypoint poses are fused while GPS is lost or faulty"),
        ({"VISO_TYPE": 0.0}, "note", "VISO_TYPE = 0: each pose resets its position: with wheels 3 % wrong 2.2 m off"),
        ({"EK3_SRC2_POSXY": 0.0}, "note", "-> set it to 6, as firmware_config/ardupilot_rover_fused.param does"),
        ({"EK3_SRC2_VELXY": 0.0}, "bad", "EK3_SRC2_VELXY = 0: between poses nothing measures its velocity"),
        ({"EK3_SRC2_YAW": 0.0}, "bad", "EK3_SRC2_YAW = 0: without the compass, each degree"),
        ({"EK3_WENC_VERR": 0.1}, "bad", "6.7 at most; with 1, 0.5 and 2.1 -> set it to 1, as"),
        ({"VISO_DELAY_MS": 110.0}, "note", "VISO_DELAY_MS = 110: each 100 ms away from it are 0.5 m along-track"),
    ],
)
def test_what_each_value_for_fused_poses_costs(
    diagnose: Diagnose, changed: dict[str, float], level: str, words: str
) -> None:
    found = diagnose({**FUSED, **changed})
    assert words in found("parameter", level)
    named = f"{found('parameter', 'bad')} | {found('parameter', 'note')}".count("_fused.param")
    assert named == len(changed), "nothing else is to be changed"


@pytest.mark.parametrize(("kind", "aid"), [("rover", WHEEL_ENCODERS), ("copter", FLOW), ("plane", AIRSPEED)])
def test_the_values_for_fused_poses_are_those_of_the_files(kind: str, aid: str) -> None:
    values = by_name(FILES / f"ardupilot_{kind}_fused.param")
    assert [level for level, *_ in judge(values, aid)] == ["good"]
    names = {name for name in values if name.startswith(("VISO_", "EK3_SRC2_", "EK3_WENC_"))}
    assert names == wanted(values) - ({"EK3_WENC_VERR"} if kind != "rover" else set())


def test_the_mode_that_a_px4_rover_falls_back_to_is_named(diagnose: Diagnose) -> None:
    def found(level: str, ev_control: float) -> str:
        return diagnose({"EKF2_EV_CTRL": ev_control, "EKF2_NOAID_TOUT": 8e6}, "px4")("parameter", level)

    words = "EKF2_NOAID_TOUT (8 s) after GPS it leaves Position for Altitude, which rovers lack"
    assert f"{words}, and a mission for Descend -> put Stabilized or Manual on a switch" in found("note", 0.0)
    assert "it stays in Position" in found("good", 4.0)


def test_what_keeps_positions_from_replacing_a_wrong_gps_is_named(diagnose: Diagnose) -> None:
    """On a PX4 that nothing but GPS gives a velocity."""
    values = {"EKF2_EV_CTRL": 0.0, "EKF2_GPS_MODE": 0.0}
    found = diagnose(values, "px4", sections={"gates": {"doubted_gps": "send"}})
    assert "no velocity aid" in found("autopilot", "bad")
    assert "px4_velocity_aid.params" in found("autopilot", "bad")
    assert '[gates] doubted_gps = "send" sends no position' in found("autopilot", "bad")
    assert "PX4 goes back to GPS between positions" in found("parameter", "bad")
    words = 'PX4 goes on using a GPS that is wrong, and ignores positions far from it -> set "switch"'
    assert words in found("parameter", "bad")


SWITCH = {"gates": {"doubted_gps": "switch"}}


@pytest.mark.parametrize(("firmware", "works"), [("px4", True), ("px4-1.17", False)])
def test_whether_a_wrong_gps_can_be_taken_from_px4_is_named(diagnose: Diagnose, firmware: str, works: bool) -> None:
    found = diagnose({"EKF2_EV_CTRL": 4.0}, firmware, sections=SWITCH)
    assert ("its GPS can be switched" in found("parameter", "good")) == works
    ignored = "ignores positions far from it -> it needs the released PX4 1.18"
    assert (ignored in found("parameter", "bad")) != works


@pytest.mark.parametrize(
    ("firmware", "motion", "level", "words"),
    [
        ("ardupilot", "off", "good", "the witness is heard: gyros and wheels"),
        ("px4", "off", "bad", "is declared faulty only with a speed without GPS"),
        ("px4", "odometer", "good", "gyros, and the camera while it sees the road"),
    ],
)
def test_a_wrong_gps_is_replaced_only_where_a_witness_is_heard(
    diagnose: Diagnose, firmware: str, motion: str, level: str, words: str
) -> None:
    errors = OdometryErrors() if firmware == "ardupilot" else OdometryErrors("velocity sensor")
    sections = {**SWITCH, "motion": {"use": motion}}
    found = diagnose({"EKF2_EV_CTRL": 4.0}, firmware, wait_s=8.0, sections=sections, errors=errors)
    assert words in found("autopilot", level)


def test_a_px4_that_was_left_without_its_gps_is_named(diagnose: Diagnose) -> None:
    found = diagnose({}, "px4", sections=SWITCH, source_set=2)
    assert "PX4 is set not to use its GPS, which works -> add 1 to EKF2_SENS_EN" in found("parameter", "bad")


def test_integers_of_px4_come_as_bytes(diagnose: Diagnose) -> None:
    def as_float(number: int) -> float:
        return float(struct.unpack("<f", struct.pack("<i", number))[0])

    values = {"EKF2_AGP0_CTRL": as_float(1), "EKF2_AGP0_ID": as_float(2)}
    found = diagnose(values, "px4", emit="global_position_sensor", kind=mavlink.MAV_PARAM_TYPE_INT32)
    assert "EKF2_AGP0_CTRL = 1" in found("parameter", "good")
    assert "EKF2_AGP0_ID = 2: it must equal [telemetry] sensor_id -> set it to 1" in found("parameter", "bad")


def test_no_port_no_camera_no_map(write_config: Callable[..., Path], tmp_path: Path) -> None:
    config = write_config(camera={"kind": "v4l2", "device": "/dev/no-camera"}, map={"path": str(tmp_path / "none")})
    findings = list(examine(config, 0.3, tmp_path / "dev"))
    assert "no such port; is the autopilot plugged in?" in told(findings, "autopilot", "bad")
    assert "/dev/no-camera: No such file" in told(findings, "camera", "bad")
    assert "no such map" in told(findings, "map", "bad")
    assert "lookback map build FEED -o" in told(findings, "map", "bad")


def test_a_silent_port(write_config: Callable[..., Path], tmp_path: Path) -> None:
    link = open_pty()
    try:
        config = write_config(telemetry={"connection": f"serial:{link.device}:57600"})
        findings = list(examine(config, 0.3, tmp_path / "dev"))
        assert "no heartbeat in 0.3 s -> check the wires" in told(findings, "autopilot", "bad")
    finally:
        link.close()


def test_a_silent_network(write_config: Callable[..., Path], tmp_path: Path) -> None:
    config = write_config(telemetry={"connection": "udp:127.0.0.1:9"})
    found = told(list(examine(config, 0.1, dev=tmp_path / "dev")), "autopilot", "bad")
    assert "no heartbeat in 0.1 s -> check that a program sends MAVLink 2 to this address" in found


def test_devices_and_rights(tmp_path: Path) -> None:
    dev = tmp_path / "dev"
    (dev / "v4l/by-id").mkdir(parents=True)
    (dev / "v4l/by-id/usb-cam-video-index0").touch()
    (dev / "v4l/by-id/usb-gone-video-index0").symlink_to(tmp_path / "unplugged")
    findings = list(examine(None, 0.0, dev))
    assert "usb-cam-video-index0: present and accessible" in told(findings, "camera", "good")
    assert "usb-gone-video-index0: a link to a device that is gone -> unplug" in told(findings, "camera", "note")


def test_a_wrong_config_is_a_finding_and_the_rest_is_still_looked_at(tmp_path: Path) -> None:
    (tmp_path / "lookback.toml").write_text("[camera]\nfsp = 3\n")
    findings = list(examine(tmp_path / "lookback.toml", 0.0, tmp_path / "dev"))
    assert "unknown key `fsp`" in told(findings, "config", "bad")
    assert told(findings, "clock", "good")


def test_a_recorded_feed_needs_no_camera(write_config: Callable[..., Path], tmp_path: Path) -> None:
    findings = list(examine(write_config(), 0.1, dev=tmp_path / "dev"))
    if not any("OAK device" in one.words for one in findings):
        assert '[camera] kind = "feed" needs none' in told(findings, "camera", "good")


def test_a_config_that_is_not_there(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", "nowhere.toml"]) == 1
    printed = capsys.readouterr().out
    assert "name the config file of `lookback run`" in printed
    assert printed.endswith(" to fix, marked BAD, before `lookback run` can do all of its work\n")


def test_what_is_tried_again_is_not_logged_as_well(
    write_config: Callable[..., Path], capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    main(["doctor", str(write_config()), "--seconds", "0.1"])
    assert "none: no such port" in capsys.readouterr().out
    assert caplog.records == []


def test_json_and_the_exit_code(write_config: Callable[..., Path], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", str(write_config()), "--json", "--seconds", "0.1"]) == 1
    findings = json.loads(capsys.readouterr().out)
    assert {"level", "what", "words", "remedy"} == set(findings[0])
    assert any(one["what"] == "autopilot" and one["level"] == "bad" for one in findings)


def test_printed_for_people(capsys: pytest.CaptureFixture[str]) -> None:
    main(["doctor"])
    assert "lookback doctor CONFIG; `lookback config > lookback.toml` writes one" in capsys.readouterr().out


def test_check_needs_a_config(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["doctor", "--offline"])
    assert ended.value.code == 2
    assert "name a config file" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("section", "values", "words"),
    [
        ("camera", {"kind": "usb"}, "[camera] kind: unknown camera 'usb'; use one of v4l2, oak, stream, feed, sim"),
        (
            "telemetry",
            {"connection": "udp://127.0.0.1:14550"},
            "[telemetry] connection: 'udp://127.0.0.1:14550' is not",
        ),
    ],
)
def test_offline_finds_what_a_run_would_end_with(
    write_config: Callable[..., Path],
    capsys: pytest.CaptureFixture[str],
    section: str,
    values: dict[str, str],
    words: str,
) -> None:
    assert main(["doctor", "--offline", str(write_config(**{section: values}))]) == 78
    assert words in " ".join(capsys.readouterr().out.split())


def test_offline_opens_no_device(write_config: Callable[..., Path], capsys: pytest.CaptureFixture[str]) -> None:
    """The port and the camera of this config are not there, and only the links' own words are checked."""
    config = write_config(camera={"kind": "v4l2", "device": "/dev/no-camera"})
    assert main(["doctor", "--offline", str(config)]) == 0
    kinds = {line[6:].split()[0] for line in capsys.readouterr().out.splitlines() if line[:4] in ("ok  ", "BAD ")}
    assert kinds == {"config", "model", "map", "link"}


@pytest.mark.parametrize(
    ("connection", "warned"),
    [("udpin:0.0.0.0:14550", True), ("udpin:0.0.0.0:14550@192.168.2.1", False), ("udpin:127.0.0.1:14550", False)],
)
def test_a_link_that_answers_the_first_sender_is_named(
    connection: str, warned: bool, write_config: Callable[..., Path]
) -> None:
    findings = list(examine(write_config(telemetry={"connection": connection}), 0.1, offline=True))
    assert ("the first sender is answered" in told(findings, "link", "note")) == warned


@pytest.mark.parametrize(("connection", "warned"), [("udp:10.0.0.1:14550", True), ("udp:127.0.0.1:14550", False)])
def test_who_can_request_a_way_home_is_said(connection: str, warned: bool, write_config: Callable[..., Path]) -> None:
    config = write_config(telemetry={"connection": connection}, home={"enabled": True})
    said = told(list(examine(config, 0.1, offline=True)), "link", "note")
    assert ("while a person steers (MAV_CMD 31014)" in said) == warned


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root")
def test_root_runs_no_command_of_a_config(write_config: Callable[..., Path], tmp_path: Path) -> None:
    config = write_config(camera={"kind": "stream", "device": f"exec:touch {tmp_path / 'run'}"})
    findings = list(examine(config, 0.1, tmp_path / "dev"))
    assert "not tried, since root would run its command" in told(findings, "camera", "note")
    assert not (tmp_path / "run").exists()


def test_a_field_of_view_that_is_not_set_or_differs_is_named(
    write_config: Callable[..., Path], make_street: Callable[..., Path], tmp_path: Path
) -> None:
    def said(**camera: float) -> str:
        config = write_config(
            camera={"kind": "feed", "device": str(short / "feed"), **camera}, map={"path": str(short / "map")}
        )
        config.write_text(
            "\n".join(line for line in config.read_text().splitlines() if camera or "fov_deg" not in line)
        )
        return told(list(examine(config, 0.1, offline=True)), "camera", "note")

    short = make_street(range(12))
    assert not said()  # without keypoints it is of no use
    key = partial(keypoints_key, fov_deg=66.0)
    add_keypoints(open_map(short / "map", every_file=True), [read_feed(short / "feed")], key)
    assert said().startswith(
        "[camera] fov_deg: is not set; keypoints take it to be 66 degrees, the map's -> `lookback cal"
    )
    assert not said(fov_deg=80.0)
    with closing(Journal(tmp_path / "events.jsonl")) as journal:
        journal.write(CameraDiffers(80.0, 87.9, 0.6, -0.01, 0.02))
        journal.write(StateChanged("on the map"))
    words = said(fov_deg=80.0)
    assert words.startswith(
        "a drive saw 87.9 ± 0.6 degrees, k1 -0.01; the config then had 80 degrees -> `lookback calibrate"
    )
