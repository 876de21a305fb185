"""`lookback bundle`: what is in it, what is not, and that it is replayed."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from edge.__main__ import main
from edge.config import Config
from edge.localization import AutopilotState, FixRequest, PositionEstimator
from edge.localization.drive_file import DriveFile
from edge_plugins.mapping.place_log import SUFFIX
from sim.bundle import LIST

TOKEN, PASSWORD = "credential:a-key-of-the-link", "pass-of-the-camera"
CONFIG = f"""
[camera]
kind = "stream"
device = "rtsp://admin:{PASSWORD}@10.0.0.2/main?auth_token=abcdef"
[descriptor]
model = "grid"
[map]
path = "street/map"
[telemetry]
signing_key = "{TOKEN}"  # not {TOKEN}
connection = "serial:/dev/ttyAMA0:921600"
journal = "events.jsonl"
drive = "newest.drive"
"""


@pytest.fixture
def config(tmp_path: Path) -> Path:
    file = tmp_path / "lookback.toml"
    file.write_text(CONFIG)
    return file


def test_a_bundle_has_what_happened_and_no_secret(
    config: Path, make_street: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    make_street(range(30)).rename(tmp_path / "street")
    (tmp_path / f"street/map/.drive{SUFFIX}").write_bytes(b"places of a drive with their pictures")
    for name in ("events.jsonl", "events.jsonl.1"):
        (tmp_path / name).write_text(f'{{"event": "camera", "why": "rtsp://admin:{PASSWORD}@10.0.0.2 {TOKEN}"}}\n')
    (tmp_path / "printed.log").write_text(f"lookback: camera rtsp://admin:{PASSWORD}@10.0.0.2\n")
    file = DriveFile(tmp_path / "newest.drive", Config())
    drive = PositionEstimator(Config(), file.write)
    drive.update(1_000_000_000, AutopilotState(gps="healthy"))
    drive.fix(2_000_000_000, FixRequest())
    file.close()
    words = ["bundle", str(config), "-o", str(tmp_path / "it.zip"), "--log", str(tmp_path / "printed.log")]
    assert main(words) == 0
    assert "without" not in capsys.readouterr().out
    with zipfile.ZipFile(tmp_path / "it.zip") as bundle:
        names = set(bundle.namelist())
        whole = b"".join(map(bundle.read, names))
        about, journal = json.loads(bundle.read("bundle.json")), bundle.read("journal.jsonl.1").decode()
    assert TOKEN.encode() not in whole and PASSWORD.encode() not in whole and b"abcdef" not in whole
    assert names >= {"bundle.json", "config.toml", "doctor.json", "journal.jsonl", "drive.list", "log.txt"}
    assert {"maps/map/map.json", "maps/map/places.bin"} <= names and "maps/map/thumbnails.jpgs" not in names
    assert f"maps/map/.drive{SUFFIX}" not in names
    assert journal == '{"event": "camera", "why": "rtsp://10.0.0.2 ***"}\n'
    assert about["missing"] == {} and any(one.startswith("numpy ") for one in about["packages"])
    assert main(["dev", "drive", str(tmp_path / "it.zip")]) == 0
    assert "0 of 1 answers differ from those of the drive" in capsys.readouterr().out
    assert main(words) == 78, "it is not overwritten"
    assert main([*words[:2], "-o", str(tmp_path / "seen.zip"), *words[4:], "--pictures"]) == 0
    with zipfile.ZipFile(tmp_path / "seen.zip") as bundle:
        assert {"maps/map/thumbnails.jpgs", f"maps/map/.drive{SUFFIX}"} <= set(bundle.namelist())


def test_what_is_missing_is_named_with_what_to_do(
    config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config.write_text(CONFIG.replace('drive = "newest.drive"', ""))
    words = ["bundle", str(config), "-o", str(tmp_path / "it.zip"), "--log", str(tmp_path / "none.log")]
    assert main(words) == 0
    printed = capsys.readouterr().out
    for line in (
        f"without the journal: {tmp_path}/events.jsonl: no such file",
        'without the list of the drive: [telemetry] drive is "": set it for the next drive',
        f"without the map: {tmp_path}/street/map: no such folder",
        "none.log'; name it with --log",
    ):
        assert line in printed
    assert main(["dev", "drive", str(tmp_path / "it.zip")]) == 78
    assert "it.zip: no drive.list in it" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("level", "lines", "why"),
    [(zipfile.ZIP_STORED, b"{}\n" * 9, "is damaged"), (zipfile.ZIP_DEFLATED, b"0" * 10**9, "MB")],
)
def test_a_bundle_that_is_damaged_or_a_bomb_is_one_line(
    level: int, lines: bytes, why: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "it.zip"
    with zipfile.ZipFile(file, "w", level) as bundle:
        bundle.writestr(LIST, lines)
    file.write_bytes(file.read_bytes().replace(b"{}", b"{ ", 1))  # its checksum is another one
    assert main(["dev", "drive", str(file)]) != 0
    (line,) = capsys.readouterr().err.splitlines()
    assert str(file) in line and why in line
