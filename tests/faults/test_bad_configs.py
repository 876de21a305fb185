"""Every mistake that a configuration can have: exit 78, and one line that names the file and the key."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from edge.__main__ import main

LONG = "x" * 300
SECTIONS: list[tuple[str, str, Any]] = [
    ("camera", "kind", "webcam"),
    ("camera", "view", "left"),
    ("camera", "device", 0),
    ("camera", "device", ""),
    ("camera", "fps", 0),
    ("camera", "fps", float("nan")),
    ("camera", "stall_timeout_s", float("inf")),
    ("sampling", "by", "meters"),
    ("sampling", "spacing_m", 101.0),
    ("descriptor", "region_width", 1.5),
    ("descriptor", "keep_statistics_min", 1441),
    ("map", "places_per_frame", 99),
    ("map", "path", ["map"]),
    ("sequence", "directions", "sideways"),
    ("acceptance", "uniqueness_min", 0.99),
    ("rig", "ahead_forward_same_m", 501),
    ("rig", "sigma_cross_track_m", "2 m"),
    ("tracking", "heading_error_deg", 31),
    ("gates", "risk", 0),
    ("gates", "with_gps", 1),
    ("telemetry", "connection", "serial:/dev/ttyUSB0"),
    ("telemetry", "connection", "tls:127.0.0.1:5760"),
    ("telemetry", "connection", "udp:127.0.0.1:65536"),
    ("telemetry", "connection", "serial:/dev/ttyUSB0:fast"),
    ("telemetry", "emit", "gps_input"),
    ("telemetry", "component_id", 0),
    ("telemetry", "origin", [1.0, 2.0]),
    ("telemetry", "origin", [91.0, 0.0, 0.0]),
    ("telemetry", "signing_key", "no-such-key"),
    ("telemetry", "links", [{"connection": "nowhere"}]),
    ("telemetry", "links", [{"signing_key": "x"}]),
    ("telemetry", "journal", "/proc/no/journal"),
    ("page", "port", 70000),
]
TEXTS: list[tuple[str, str]] = [
    ("[camera\n", "not TOML"),
    ("[camera]\nfps = 15\nfps = 16\n", "not TOML"),
    ("camera = 3\n", "[camera]"),
    ("[camra]\nfps = 15\n", "camra"),
    (f"[{LONG}]\n", LONG),
    ('[telemetry]\njournal = "a\\u0000b"\n', "journal"),
    ('[map]\npath = "a\\u0000b"\n', "path"),
    ("[map]\npath = 'no-such-map'\n[telemetry]\njournal = ''\n", "no-such-map"),
    ('[descriptor]\nmodel = "a\\u0000b"\n', "model"),
    (f"[camera]\nfps = {'9' * 5000}\n", "thousands of digits"),
    (f"[camera]\nfps = {'[' * 2000}{']' * 2000}\n", "nested more than"),
    (f"{'.'.join(['camera'] * 2000)} = 1\n", "nested more than"),
]


def refused(config: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture) -> str:
    """Run the daemon, which must refuse; its one line."""
    capsys.readouterr()
    assert main(["run", str(config)]) == 78
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1, err
    assert "Traceback" not in err
    return err


@pytest.mark.parametrize(("section", "key", "value"), SECTIONS, ids=lambda value: str(value)[:24])
def test_a_value(
    section: str,
    key: str,
    value: Any,
    write_config: Callable[..., Path],
    capsys: pytest.CaptureFixture[str],
    caplog: pytest.LogCaptureFixture,
) -> None:
    config = write_config(**{section: {key: value}})
    line = refused(config, capsys, caplog)
    assert f"[{section}]" in line or f"[[{section}." in line
    assert key in line
    assert str(config) in line


@pytest.mark.parametrize(("text", "named"), TEXTS, ids=lambda value: str(value)[:24])
def test_a_text(
    text: str, named: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    config = tmp_path / "lookback.toml"
    config.write_text(text)
    line = refused(config, capsys, caplog)
    assert named in line
    assert str(tmp_path) in line


def test_a_file_that_is_none(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "binary.toml").write_bytes(os.urandom(100) + b"\xff")
    for name in ("missing.toml", "binary.toml", "."):
        assert str(tmp_path / name) in refused(tmp_path / name, capsys, caplog)
