"""`lookback eval` on a street that was mapped, and on what is wrong with a recording."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from statistics import median

import cv2
import numpy as np
import pytest

from edge.__main__ import main


@pytest.fixture(scope="module")
def street_map(write_traverse: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("eval")
    write_traverse(folder / "out", range(65))
    assert main(["map", "build", str(folder / "out"), "-o", str(folder / "map")]) == 0
    return folder / "map"


@pytest.fixture(scope="module")
def plain_map(street_map: Path) -> Path:
    """The same without keypoints."""
    path = street_map.with_name("plain")
    assert main(["map", "build", str(street_map.with_name("out")), "-o", str(path), "--no-keypoints"]) == 0
    return path


def test_the_numbers_are_those_of_replay(
    street_map: Path, write_traverse: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """80 frames of 2 m, of which 65 are mapped; a sequence of 40 ends at frame 39 first."""
    again, lines, report = write_traverse(tmp_path / "again", noise=8.0), tmp_path / "lines", tmp_path / "report"
    assert main(["replay", str(again), "--map", str(street_map), "--all", "-o", str(lines)]) == 0
    assert main(["eval", str(again), "--map", str(street_map), "--tolerance-m", "5", "-o", str(report)]) == 0
    believed = [line for line in map(json.loads, lines.read_text().splitlines()) if line["accepted"]]
    errors_m = [abs((line["lat_deg"] + 27.0) * 110_800 - 2 * line["frame"]) for line in believed]
    right = [line for line, error_m in zip(believed, errors_m, strict=True) if error_m <= 5 and line["frame"] < 67]
    assert 10 < len(right) < len(believed)  # off the map, the last lines are believed for a while
    printed = capsys.readouterr()
    assert "calibrate" not in printed.err
    name, frames, on_map, precision, recall, _, _, error_m, _ = printed.out.splitlines()[1].split()
    assert (name, int(frames), int(on_map)) == ("again", 80, 67)  # two frames are within 5 m of the map's end
    assert float(precision) == pytest.approx(len(right) / len(believed), abs=1e-3)
    assert float(recall) == pytest.approx(len(right) / 67, abs=1e-3)
    assert float(error_m) == pytest.approx(median(errors_m), abs=0.02)
    assert {path.name for path in report.iterdir()} == {"report.html", "recordings.csv", "precision_recall.png"}


def test_worse_pictures_are_recognized_or_the_camera_is_said_to_show_nothing(
    street_map: Path, write_traverse: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["eval", str(write_traverse(tmp_path / "again", range(65))), "--map", str(street_map), "--corrupt"]
    assert main([*words, "rain:3", "--corrupt", "mud:3", "--corrupt", "dark:5"]) == 0
    rows = [[one.strip() for one in row.split("  ") if one] for row in capsys.readouterr().out.splitlines()[1:]]
    assert [(row[3], row[-1], float(row[4]) > 0.6) for row in rows[:3]] == [("1.000", "-", True)] * 3
    assert rows[3][0] == "again, dark:5" and rows[3][4:] == ["0.000"] * 3 + ["nan"] * 2 + ["the image is dark 0.83"]
    assert main([*words, "rain"]) == 78


def test_a_single_picture_is_placed_by_its_inliers(
    street_map: Path,
    plain_map: Path,
    write_traverse: Callable[..., Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """At 7.6 m between pictures a frame whose own place has 400 inliers was matched 17 m off by the sequence."""
    again = write_traverse(tmp_path / "again", range(22), noise=8.0)
    picture, drawn = sorted((again / "frames").iterdir())[20], tmp_path / "six.png"
    assert main(["where", str(picture), "--map", str(street_map), "-o", str(drawn)]) == 0
    first, *nearest = capsys.readouterr().out.splitlines()
    assert first == f"{picture}: taken near place 20"
    assert len(nearest) == 6 and nearest[0].startswith("  place 20: ")
    assert nearest[0].endswith(" inliers, -26.999639, 153.000000")
    image = cv2.imread(str(drawn))
    assert image is not None and image.shape[0] == 240 and image.shape[1] == 7 * 320
    blank = tmp_path / "blank.png"
    cv2.imwrite(str(blank), np.full((120, 160, 3), 128, np.uint8))
    assert main(["where", str(blank), "--map", str(street_map)]) == 0
    assert "shows no place for sure" in capsys.readouterr().out
    assert main(["where", str(picture), "--map", str(plain_map)]) == 78
    assert "plain: no keypoints; add them with `lookback map keypoints`" in capsys.readouterr().err


def test_local_meters_are_compared_only_with_those_from_the_same_origin(
    street_map: Path, write_traverse: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two recordings of other roads that both begin at 0, 0 were "24 of 24 on the map"."""
    for name in ("hall", "yard"):
        rows = write_traverse(tmp_path / name, range(45)) / "frames.csv"
        names, *lines = [line.split(",") for line in rows.read_text().splitlines()]
        for line in lines:
            line[names.index("position_source")] = "local"
        rows.write_text("".join(",".join(line) + "\n" for line in (names, *lines)))
    hall, yard = str(tmp_path / "hall"), str(tmp_path / "yard")
    refused = 'are compared only with those from the same one. If it is that of {0}, set origin = "{0}"'
    for words, origin in (
        (["eval", yard, "--map", str(street_map)], "out"),
        (["try", hall, yard, "-o", str(tmp_path / "tried")], "hall"),
    ):
        assert main(words) == 78
        error = capsys.readouterr().err
        assert refused.format(origin) in error and "\n" not in error.strip()
    header = tmp_path / "yard/feed.toml"
    header.write_text(header.read_text().replace('origin = ""', 'origin = "hall"'))
    assert main(["map", "build", hall, "-o", str(tmp_path / "map"), "--no-keypoints"]) == 0
    assert main(["eval", yard, "--map", str(tmp_path / "map"), "--tolerance-m", "5"]) == 0
    assert capsys.readouterr().out.splitlines()[-1].split()[:3] == ["yard", "45", "45"]


def test_what_a_covered_camera_shows_is_no_place(
    plain_map: Path, write_traverse: Callable[..., Path], tmp_path: Path
) -> None:
    """Covered from 40 to 60 m, with the noise of its sensor: no frame of it is used, and a new sequence begins."""
    again, lines = write_traverse(tmp_path / "again", noise=8.0), tmp_path / "lines"
    covered, options = range(20, 30), ["--sequence-length", "10", "--all", "-o", str(lines)]
    rng = np.random.default_rng(0)
    for frame in covered:
        gray = rng.normal(120, 6, (120, 160, 3)).clip(0, 255).astype(np.uint8)
        assert cv2.imwrite(str(sorted((again / "frames").iterdir())[frame]), gray)
    assert main(["replay", str(again), "--map", str(plain_map), *options]) == 0
    used = {line["frame"]: line["accepted"] for line in map(json.loads, lines.read_text().splitlines())}
    assert used[19] and set(used) == set(range(80)) - set(covered)
    assert [used[frame] for frame in range(30, 39)] == [False] * 9, "as few frames as a sequence needs"
    assert used[50]


@pytest.mark.parametrize(("ahead_m", "side"), [(-30.0, "ahead of"), (30.0, "behind")])
def test_an_offset_near_the_tolerance_is_warned_of(
    plain_map: Path,
    write_traverse: Callable[..., Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    ahead_m: float,
    side: str,
) -> None:
    """The camera sees places where it is, and the config says that they lie elsewhere."""
    again, config = write_traverse(tmp_path / "again", range(65), noise=8.0), tmp_path / "rig.toml"
    config.write_text(f"[rig]\nahead_forward_same_m = {ahead_m}\n")
    options = ["eval", str(again), "--map", str(plain_map), "--config", str(config)]
    assert main(options) == 0
    warning = capsys.readouterr().err
    assert f"again: the median accepted place lies 30 m {side} the vehicle, and the tolerance is 40 m" in warning
    assert "lookback calibrate" in warning
    assert main([*options, "--tolerance-m", "20"]) == 0
    at_100, within_twice = map(float, capsys.readouterr().out.splitlines()[1].split()[5:7])
    assert at_100 < 0.2, "but for places beyond the map's ends, which lie there"
    assert within_twice > at_100 + 0.2


def test_a_recording_without_positions_is_one_line(
    street_map: Path, write_traverse: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    nowhere = write_traverse(tmp_path / "nowhere", range(45), is_located=False)
    config = tmp_path / "frames.toml"
    config.write_text('[sampling]\nby = "frames"\nspacing_frames = 1\n')
    assert main(["eval", str(nowhere), "--map", str(street_map), "--config", str(config)]) == 78
    assert "nothing can be judged" in capsys.readouterr().err
    assert main(["eval", str(nowhere), "--map", str(street_map), "--tolerance-m", "0"]) == 78
    assert "--tolerance-m: 0 is not above 0" in capsys.readouterr().err
