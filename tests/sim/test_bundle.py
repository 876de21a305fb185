"""`lookback bundle`: what is in it, what is not, and that it is replayed."""

from __future__ import annotations

import gzip
import json
import zipfile
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest
from msgspec.structs import replace

from edge.__main__ import main
from edge.commands.parser import build_parser
from edge.config import Config
from edge.localization import AutopilotState, FixRequest, NoFix, PositionEstimator
from edge.localization.drive_file import LENGTH, DriveFile, read_drive
from edge.localization.position_estimator import FixResult
from edge_plugins.mapping.place_log import SUFFIX
from sim.bundle import LIST
from tests.localization.events_of import Road, Vehicle, gps_at, settings
from tests.localization.route_course import Stretch

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


def test_it_names_each_answer_that_differs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "list.drive"
    file = DriveFile(path, Config())
    drive = PositionEstimator(Config(), file.write)
    drive.update(1_000_000_000, AutopilotState(gps="healthy"))
    answer = drive.fix(2_000_000_000, FixRequest())
    assert isinstance(answer, NoFix)
    file.write(3_000_000_000, FixResult(FixRequest(), replace(answer, reason="too old")))
    file.close()
    words = ["dev", "drive", str(path)]
    args = build_parser(words).parse_args(words)
    assert args.run(args) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines == [
        "     2.00 s  the places do not agree yet  (then: too old)",
        "      2 times: the places do not agree yet",
        "1 of 2 answers differ from those of the drive",
    ]


def test_a_list_in_the_words_of_the_version_before_is_read(tmp_path: Path) -> None:
    """Positions and the config had other keys."""
    path = tmp_path / "it.drive"
    file = DriveFile(path, settings())
    vehicle = Vehicle(Road(tmp_path, Stretch(0, 300)), listeners=[file.write])
    for row in range(100):
        vehicle.move()
        vehicle.own(has_gps=row < 50)
        vehicle.show(vehicle.road.match(vehicle.north_m), gps_at(vehicle.north_m) if row < 50 else None)
        vehicle.ask()
    file.close()
    config, entries = read_drive(path)
    old = gzip.decompress(path.read_bytes())
    parts, at = [], 0
    while at < len(old):
        size = LENGTH.unpack_from(old, at)[0]
        one = old[at + LENGTH.size : at + LENGTH.size + size]
        one = one.replace(b"\xb3sigma_cross_track_m", b"\xaesigma_across_m")
        parts.append(LENGTH.pack(len(one)) + one)
        at += LENGTH.size + size
    assert b"".join(parts) != old
    path.write_bytes(gzip.compress(b"".join(parts)))
    before, read = read_drive(path)
    assert before == config
    assert [msgspec.json.encode(one) for _, one in read if isinstance(one, FixResult)] == [
        msgspec.json.encode(one) for _, one in entries if isinstance(one, FixResult)
    ]
