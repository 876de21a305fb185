"""`lookback shadow`: whether standard deviations are true, and where positions are good enough."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path

import msgspec
import numpy as np
import pytest

from edge.__main__ import main
from edge.geodesy import moved
from edge.journal.journal import Journal
from edge.localization import CORRELATION_M
from edge.telemetry.shadow import ShadowPosition
from sim.shadow.command import report, text, verdict
from sim.shadow.drives import LATE_S, elevation_deg, read_drives

HOME = (48.1, 11.5)
NOON_S = datetime(2026, 6, 1, 11, 0, tzinfo=timezone.utc).timestamp()
SPEED_MPS, LENGTH_M = 8.0, 1000.0
LIMITS = {"light": None, "fewest": 3, "within_m": 20.0, "stretch_m": 100.0, "drift": 0.05}


@dataclass
class Diary:
    """A drive to the east, or back. sigmas_m: published, times: what the errors are of them. gps_m: the error of GPS.

    says_m, source: what it says of itself. silent_m: where nothing is published. late_s: GPS is late by.
    """

    seed: int
    begins_s: float = NOON_S
    times: float = 1.0
    sigmas_m: tuple[float, float] = (3.0, 2.0)
    gps_m: float = 1.0
    says_m: float | None = 1.0
    source: str = "gps"
    silent_m: tuple[float, float] = (0.0, 60.0)
    late_s: float = 0.0
    off_m: float = 0.0
    is_back: bool = False

    def write(self, path: Path) -> Path:
        now_s = [self.begins_s]
        journal, rng = Journal(path, unix_time_s=lambda: now_s[0]), np.random.default_rng(self.seed)
        errors, kept = rng.normal(size=2), math.exp(-SPEED_MPS / CORRELATION_M)
        gps = rng.normal(size=2)
        for step in range(round(LENGTH_M / SPEED_MPS)):
            errors = kept * errors + math.sqrt(1 - kept**2) * rng.normal(size=2)
            gps = 0.97 * gps + math.sqrt(1 - 0.97**2) * rng.normal(size=2)
            at_m = SPEED_MPS * step
            east_m = LENGTH_M - at_m if self.is_back else at_m
            off_m = self.times * np.array(self.sigmas_m) * errors
            gps_m = self.gps_m / math.sqrt(2) * gps - (self.late_s * SPEED_MPS, 0.0)
            one = ShadowPosition(
                step * 1_000_000_000,
                SPEED_MPS,
                at_m,
                "the places do not agree yet",
                *moved(*HOME, east_m + gps_m[0], gps_m[1]),
                self.says_m,
                self.source,
            )
            if not self.silent_m[0] <= at_m < self.silent_m[1]:
                lat_deg, lon_deg = moved(*HOME, east_m + off_m[0] + self.off_m, off_m[1])
                one = msgspec.structs.replace(
                    one,
                    withheld="",
                    lat_deg=lat_deg,
                    lon_deg=lon_deg,
                    heading_deg=90.0,
                    sigma_along_m=self.sigmas_m[0],
                    sigma_cross_track_m=self.sigmas_m[1],
                    direction="reverse",
                    order="same",
                )
            journal.write(one)
            now_s[0] += 1
        journal.close()
        return path


def factors(folder: Path, drives: Sequence[Diary]) -> list[bool]:
    """Whether each of both standard deviations is found to be too small."""
    paths = [one.write(folder / f"{one.seed}_{row}.jsonl") for row, one in enumerate(drives)]
    (positions,) = report(read_drives(paths), **LIMITS).lights.values()  # type: ignore[arg-type]
    found = [positions.factor(axis) for axis in range(2)]
    for path in paths:
        path.unlink()
    return [one is not None and one.is_too_small for one in found]


def test_a_sigma_1_5_times_too_small_is_found_within_three_drives_of_a_kilometer(tmp_path: Path) -> None:
    """Of 20 weeks each, of which none with a true one may be called too small by more than chance."""
    found = {
        times: [
            one for week in range(20) for one in factors(tmp_path, [Diary(3 * week + n, times=times) for n in range(3)])
        ]
        for times in (1.0, 1.5)
    }
    assert sum(found[1.5]) >= 34, "of 40"
    assert sum(found[1.0]) <= 3


def test_a_gps_that_is_late_or_coarse_is_not_our_error(tmp_path: Path) -> None:
    """Without counting it, both would make our standard deviations look too small."""
    drives = [Diary(n, sigmas_m=(0.6, 0.6), gps_m=2.0, says_m=2.0, late_s=LATE_S) for n in range(3)]
    assert factors(tmp_path, drives) == [False, False]
    assert factors(tmp_path, [Diary(n, sigmas_m=(0.6, 0.6), gps_m=2.0, says_m=0.1) for n in range(3)]) == [True, True]


@pytest.mark.parametrize(("says_m", "source"), [(8.0, "gps"), (None, "gps"), (0.5, "dead_reckoning")])
def test_a_drive_whose_gps_was_bad_is_no_judge(says_m: float | None, source: str, tmp_path: Path) -> None:
    paths = [Diary(n).write(tmp_path / f"{n}.jsonl") for n in range(3)]
    paths.append(Diary(9, NOON_S + 86_400, off_m=60.0, says_m=says_m, source=source).write(tmp_path / "bad.jsonl"))
    found = report(read_drives(paths), **LIMITS)  # type: ignore[arg-type]
    assert (len(found.drives), len(found.judges)) == (4, 3)
    assert max(one.positions.error_m.max(initial=0.0) for one in found.stretches) < 20
    assert "no judge" in "\n".join(text(found))
    alone = report(read_drives(paths[3:]), **LIMITS)  # type: ignore[arg-type]
    assert "no drive had GPS that can judge" in "\n".join(verdict(alone))


def test_ready_here_and_not_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Four drives by day, one of them with nothing from 330 m on; one by night."""
    paths = [Diary(n, NOON_S + 86_400 * n, times=0.5, gps_m=0.0).write(tmp_path / f"{n}.jsonl") for n in range(3)]
    silent = Diary(4, NOON_S - 86_400, times=0.5, silent_m=(330.0, 990.0)).write(tmp_path / "silent.jsonl")
    night = Diary(5, NOON_S - 43_200, times=0.5).write(tmp_path / "night.jsonl")
    assert main(["shadow", *map(str, [*paths, silent, night]), "-o", str(tmp_path / "all.csv")]) == 0
    printed = capsys.readouterr().out
    with (tmp_path / "all.csv").open() as file:
        rows = list(csv.DictReader(file))
    by_day = [row for row in rows if row["light"] == "day"]
    assert [row["ready"] for row in by_day] == [*["True"] * 7, *["False"] * 3]
    assert {row["why"] for row in by_day[:7]} == {""} and "without a position" in by_day[8]["why"]
    by_night = [row for row in rows if row["light"] == "night"]
    assert {row["ready"] for row in by_night} == {"False"}
    assert all(row["why"].startswith("more drives are needed") for row in by_night)
    assert "Ready in parts by day: 716 of 991 m of road; up to 4 drives" in printed
    assert "Not ready by night: 0 of 991 m of road; up to 1 drives" in printed
    words = ["shadow", *map(str, paths), "--light", "day", "--since", "2026-06-02"]
    assert main([*words, "-o", str(tmp_path / "a.geojson")]) == 0
    stretches = json.loads((tmp_path / "a.geojson").read_text())["features"]
    assert len(stretches) == 10 and len(stretches[0]["geometry"]["coordinates"]) > 15
    assert {one["properties"]["drives"] for one in stretches} == {2}
    pytest.importorskip("matplotlib", reason="needs the extra `sim`")
    assert main([*words, "--report", str(tmp_path / "a.html")]) == 0
    page = (tmp_path / "a.html").read_text(encoding="utf-8")
    assert page.count("data:image/png") == 1 and "Judged by GPS on 2 drives" in page


def test_both_directions_of_a_road_are_stretches_of_their_own(tmp_path: Path) -> None:
    drives = [Diary(n, NOON_S + 86_400 * n, is_back=n % 2 == 1) for n in range(4)]
    paths = [one.write(tmp_path / f"{one.seed}.jsonl") for one in drives]
    found = report(read_drives(paths), **LIMITS)  # type: ignore[arg-type]
    headings = [round(one.span.heading_deg / 90) for one in found.stretches if one.span.length_m >= 100]
    assert headings == [1] * 9 + [3] * 9
    assert {one.drives for one in found.stretches[1:8]} == {2}


def test_the_sun_stands_where_the_almanac_has_it() -> None:
    """Values of the package astral 3.2."""
    known = np.array(
        [
            (1742778776.2551348, 8.470945414953505, -46.81614004269147, -58.342773690196225),
            (1962352023.1577168, 19.472241054587286, -156.4096106736673, -70.8898305232461),
            (1607900794.9329245, 48.058326083022095, -86.63255484191725, -11.58901226366848),
        ]
    )
    assert elevation_deg(*known[:, :3].T) == pytest.approx(known[:, 3], abs=0.02)


def test_what_cannot_be_judged_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = Diary(1).write(tmp_path / "a.jsonl")
    (tmp_path / "empty.jsonl").write_text("")
    for words, message in (
        ([tmp_path / "empty.jsonl"], 'nothing to compare in it; drive with [telemetry] emit = "report" and GPS'),
        ([tmp_path / "none.jsonl"], "cannot read it: No such file or directory"),
        ([path, "--within-m", "0"], "--within-m: 0 is not above 0"),
        ([path, "-o", tmp_path / "a.txt"], "use a name that ends in one of .csv, .geojson"),
    ):
        assert main(["shadow", *map(str, words)]) != 0
        said = capsys.readouterr().err
        assert message in said and said.count("\n") == 1
