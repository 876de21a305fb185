"""`lookback calibrate wheels` against a simulated autopilot on a pty."""

from __future__ import annotations

import io
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.__main__ import main
from sim.vehicle.autopilot import SimulatedAutopilot
from sim.vehicle.command import straight_line
from sim.vehicle.pty_link import open_pty

TWO_DRIVES = "[-0.029,0.004,0.1],[-0.028,0.004,0.1]"
Calibrate = Callable[..., str]


@pytest.fixture(params=["ardupilot"])
def autopilot(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[SimulatedAutopilot]:
    """It stands, and is heard at once; the config beside it names its link."""
    link, stop = open_pty(), threading.Event()
    journal = tmp_path / "events.jsonl"
    connection = f'connection = "serial:{link.device}:921600"\njournal = "{journal}"\n'
    (tmp_path / "lookback.toml").write_text(f"[telemetry]\n{connection}")
    one = SimulatedAutopilot(link, straight_line(0.0, 0.0, 0.0), firmware=request.param)
    values = {"WENC_TYPE": 10.0, "WENC2_TYPE": 10.0, "WENC_RADIUS": 0.1, "WENC2_RADIUS": 0.11}
    one.parameters |= {name: (value, mavlink.MAV_PARAM_TYPE_REAL32) for name, value in values.items()}
    often = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 0, mavlink.MAVLINK_MSG_ID_HEARTBEAT, 50_000
    one.handle(mavlink.MAVLink_command_long_message(1, 1, *often, *[0] * 5))
    thread = threading.Thread(target=one.run, args=(stop,))
    thread.start()
    yield one
    stop.set()
    thread.join()
    link.close()


@pytest.fixture
def calibrate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Calibrate:
    """Runs it beside what drives have found, with an answer at the terminal; gives what was said."""

    def run(*options: str, drives: str = TWO_DRIVES, answer: str = "") -> str:
        (tmp_path / "events.wheels").write_text('{"drives":{"1":[' + drives + "]}}")
        monkeypatch.setattr("sys.stdin", io.StringIO(answer))
        main(["calibrate", "wheels", str(tmp_path / "lookback.toml"), *options])
        return "".join(capfd.readouterr())

    return run


def radii(autopilot: SimulatedAutopilot) -> list[float]:
    return [autopilot.parameters[name][0] for name in ("WENC_RADIUS", "WENC2_RADIUS")]


def test_what_drives_have_found_is_set_after_a_yes_and_is_right_then(
    autopilot: SimulatedAutopilot, calibrate: Calibrate
) -> None:
    said = calibrate()
    assert "drive  2: -2.8 % +- 0.4" in said
    assert "WENC2_RADIUS is 0.11000, and should be 0.10686\n--upload sets this" in said
    for answer, words in (("", "needs a yes at the terminal"), ("n\n", "[y/N]")):
        assert words in calibrate("--upload", answer=answer)
    assert radii(autopilot) == [0.1, 0.11]
    said = calibrate("--upload", answer="y\n")
    assert "WENC_RADIUS = 0.09715: set, and read back\nWENC2_RADIUS = 0.10686: set, and read back" in said
    assert radii(autopilot) == pytest.approx([0.09715, 0.10686])
    assert "right within one standard deviation: nothing is to be set" in calibrate("--upload", "--yes")


def test_nothing_is_set_that_is_armed_or_does_not_take_it(autopilot: SimulatedAutopilot, calibrate: Calibrate) -> None:
    autopilot.base_mode = mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    assert "WENC_RADIUS was not set: the vehicle is armed" in calibrate("--upload", "--yes")
    assert not [one for one in autopilot.received if one.message.get_type() == "PARAM_SET"]
    autopilot.base_mode = 0
    autopilot.loses = lambda message, outgoing: message.get_type() == "PARAM_SET" and message.param_id == "WENC2_RADIUS"
    said = calibrate("--upload", "--yes")
    assert "WENC2_RADIUS was not set: the autopilot has not taken it; set it to 0.10686 by hand" in said
    assert radii(autopilot) == pytest.approx([0.09715, 0.11])


@pytest.mark.parametrize(
    ("autopilot", "drives", "words"),
    [
        ("ardupilot", "[-0.029,0.004,0.1]", "two drives that agree are needed"),
        ("ardupilot", "[-0.029,0.004],[-0.028,0.004]", "two drives that agree are needed"),
        ("px4", TWO_DRIVES, "PX4 has no radius to set: its filter uses no wheel encoders"),
    ],
    indirect=["autopilot"],
)
def test_what_nothing_can_be_said_of(
    autopilot: SimulatedAutopilot, calibrate: Calibrate, drives: str, words: str
) -> None:
    assert words in calibrate(drives=drives)
