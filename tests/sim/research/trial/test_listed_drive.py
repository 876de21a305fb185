"""`lookback dev flights` on a drive from the field."""

from __future__ import annotations

import gzip
import zipfile
from pathlib import Path

import msgspec
import pytest

from edge.commands.parser import build_parser
from edge.localization.drive_file import LENGTH, DriveFile, read_drive
from edge.localization.position_estimator import FixResult
from sim.bundle import LIST
from sim.research.trial.listed_drive import ListedDrive
from tests.localization.events_of import Road, Vehicle, gps_at, settings
from tests.localization.route_course import Stretch


def bundle(folder: Path, *, reports_only: bool) -> Path:
    """A vehicle that drives 300 m beside GPS, 3 m behind where GPS has it, and 200 m without."""
    file = DriveFile(folder / "it.drive", settings())
    one = Vehicle(Road(folder, Stretch(0, 600, sigma_m=1.0)), listeners=[file.write])
    one.off_m = 3.0
    for row in range(250):
        one.move()
        one.own(has_gps=row < 150)
        one.show(one.road.match(one.north_m), gps_at(one.north_m + one.off_m) if row < 150 else None)
        if not reports_only:
            one.ask()
    file.close()
    with zipfile.ZipFile(folder / "it.zip", "w") as made:
        made.write(folder / "it.drive", LIST)
    return folder / "it.zip"


def test_what_was_sent_is_what_is_sent_now(tmp_path: Path) -> None:
    found = ListedDrive(bundle(tmp_path, reports_only=False))
    assert msgspec.json.encode(found.then) == msgspec.json.encode(found.now)
    assert found.lost_m == pytest.approx(200, abs=4)
    row = found.now.row()
    assert row["sent"] > 50 and row["known"] <= 6, "without GPS no error"
    assert (row["used"], row["believed"], row["false"]) == (250, 250, 0)


def test_of_a_drive_that_sent_nothing_gps_judges_what_would_be(tmp_path: Path) -> None:
    found = ListedDrive(bundle(tmp_path, reports_only=True))
    assert not found.then.positions and found.then.silent_s == pytest.approx(20, abs=0.5)
    row = found.now.row()
    assert 50 < row["known"] < row["sent"]
    assert row["median_m"] == pytest.approx(3, abs=1), "by how much GPS is ahead"


def test_a_list_in_the_words_of_the_version_before_is_read(tmp_path: Path) -> None:
    """Positions and the config had other keys."""
    path = bundle(tmp_path, reports_only=False).with_suffix(".drive")
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


def test_the_command_has_a_row_for_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["dev", "flights", str(bundle(tmp_path, reports_only=True)), "-o", str(tmp_path / "out")]
    args = build_parser(words).parse_args(words)
    assert args.run(args) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[2].startswith("| it, then | 0 | -") and lines[3].startswith("| now | ")
    assert "All 1 drives together" in "\n".join(lines)
    assert "it, then" in (tmp_path / "out/flights.md").read_text()
