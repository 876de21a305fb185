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
    ("camera", "kind", 1),
    ("camera", "view", "left"),
    ("camera", "device", 0),
    ("camera", "device", ""),
    ("camera", "width", 15),
    ("camera", "width", 8193),
    ("camera", "height", 480.5),
    ("camera", "height", -1),
    ("camera", "fps", 0),
    ("camera", "fps", 241),
    ("camera", "fps", float("nan")),
    ("camera", "fourcc", "MJPEG"),
    ("camera", "stall_timeout_s", 0),
    ("camera", "stall_timeout_s", float("inf")),
    ("camera", "fsp", 15),
    ("sampling", "by", "meters"),
    ("sampling", "spacing_m", 0),
    ("sampling", "spacing_m", 101.0),
    ("sampling", "spacing_frames", 0),
    ("sampling", "interval_s", -0.5),
    ("descriptor", "regions", "quarters"),
    ("descriptor", "region_width", 0.05),
    ("descriptor", "region_width", 1.5),
    ("descriptor", "normalization", "batch"),
    ("descriptor", "renormalize_ring", "yes"),
    ("descriptor", "standing_change", -0.1),
    ("descriptor", "keep_statistics_min", -1),
    ("descriptor", "keep_statistics_min", 1441),
    ("map", "places_per_frame", 99),
    ("map", "path", ["map"]),
    ("sequence", "length", 1),
    ("sequence", "length", 501),
    ("sequence", "length", True),
    ("sequence", "slope_limit_rad", 0.7),
    ("sequence", "slopes", 0),
    ("sequence", "directions", "sideways"),
    ("sequence", "region_order", "both"),
    ("sequence", "max_gap_s", 0),
    ("acceptance", "uniqueness_min", 0.99),
    ("acceptance", "confidence_from", 0.0),
    ("acceptance", "window_m", -80),
    ("acceptance", "window_places", 0),
    ("acceptance", "hold_off_s", -1),
    ("rig", "ahead_forward_same_m", 501),
    ("rig", "left_forward_m", -51),
    ("rig", "sigma_along_m", 0),
    ("rig", "sigma_across_m", "2 m"),
    ("tracking", "heading_error_deg", 31),
    ("tracking", "lost_after_m", 0),
    ("tracking", "lost_after_s", 61),
    ("tracking", "scale_error_percent", 51),
    ("gates", "min_speed_mps", -1),
    ("gates", "min_interval_s", 0),
    ("gates", "risk", 0),
    ("gates", "with_gps", 1),
    ("telemetry", "connection", "serial:/dev/ttyUSB0"),
    ("telemetry", "connection", "tls:127.0.0.1:5760"),
    ("telemetry", "connection", "udp:127.0.0.1:65536"),
    ("telemetry", "connection", "serial:/dev/ttyUSB0:fast"),
    ("telemetry", "emit", "gps_input"),
    ("telemetry", "component_id", 0),
    ("telemetry", "component_id", 256),
    ("telemetry", "origin", [1.0, 2.0]),
    ("telemetry", "origin", [91.0, 0.0, 0.0]),
    ("telemetry", "signing_key", "no-such-key"),
    ("telemetry", "links", [{"connection": "nowhere"}]),
    ("telemetry", "links", [{"signing_key": "x"}]),
    ("telemetry", "journal", "/proc/no/journal"),
    ("page", "port", 70000),
    ("page", "port", -1),
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


def test_there_are_enough(figures: Callable[[str], None]) -> None:
    total = len(SECTIONS) + len(TEXTS) + 3
    figures(f"{total} bad configurations refused")
    assert total >= 60
