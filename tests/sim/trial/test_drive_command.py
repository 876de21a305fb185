"""`lookback dev drive` on the list of a drive."""

from __future__ import annotations

import gzip
from pathlib import Path

import msgspec
import pytest
from msgspec.structs import replace

from edge.commands.parser import build_parser
from edge.config import Config
from edge.localization import AutopilotState, FixRequest, NoFix, PositionEstimator
from edge.localization.drive_file import LENGTH, DriveFile, read_drive
from edge.localization.position_estimator import FixResult
from tests.localization.events_of import Road, Vehicle, gps_at, settings
from tests.localization.route_course import Stretch


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
