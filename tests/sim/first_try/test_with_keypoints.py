"""`lookback try` along real pictures: the sequence alone, with keypoints, and what single pictures are off by."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("matplotlib")

from edge.__main__ import main
from edge.reference_map import open_map
from tests.photographs import PhotographedStreet, drive

LENGTH_M = 100.0


@pytest.fixture(scope="module")
def drives(make_once: Callable[[str, Callable[[Path], object]], Path]) -> Path:
    """`out` is mapped; `again` passes from 20 to 90 m of it, half a meter to the right and darker."""

    def fill(folder: Path) -> None:
        street = PhotographedStreet(LENGTH_M)
        drive(street, folder / "out", np.arange(0.0, LENGTH_M, 2.0))
        drive(street, folder / "again", np.arange(20.0, 90.0, 2.0), right_m=0.5, light=0.8)

    return make_once("photographed", fill)


def test_a_try_shows_both_and_how_far_single_pictures_are_off(
    drives: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tried = tmp_path / "tried"
    assert main(["try", str(drives / "out"), str(drives / "again"), "-o", str(tried)]) == 0
    printed = capsys.readouterr().out
    assert open_map(tried / "map").header.keypoints_key is not None
    known = re.search(r"(\d+) of 50 keyframes have map points", printed)
    assert known and int(known[1]) > 40
    shares = re.search(
        r"of all frames, (\d+) % \((.*)\) are accepted by the sequence alone, (\d+) % \((.*)\) with", printed
    )
    assert shares and int(shares[3]) > 80 > int(shares[1])
    assert shares[4] == "first after 4 m"
    off = re.search(
        r"(\d+) pictures have a keypoint pose, off by ([\d.]+) / ([\d.]+) m .* and ([\d.]+) / ([\d.]+) m cross-track",
        printed,
    )
    assert off and int(off[1]) >= 8
    assert max(float(off[2]), float(off[4])) < 0.15 and max(float(off[3]), float(off[5])) < 0.5
    page = (tried / "report.html").read_text()
    assert "The sequence alone, and with keypoints" in page and off[0] in page


@pytest.mark.long  # a whole try more, for one line of the verdict
def test_any_video_has_keypoints_and_a_try_says_what_its_field_of_view_would_be_worth(
    drives: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("out", "again"):
        header = shutil.copytree(drives / name, tmp_path / name) / "feed.toml"
        header.write_text(re.sub("(?m)^fov_deg.*$", "", header.read_text()))
    assert main(["try", str(tmp_path / "out"), str(tmp_path / "again"), "-o", str(tmp_path / "tried")]) == 0
    printed = capsys.readouterr().out
    found = re.search(r"(?s)(\d+) % \(first after 4 m\) with keypoints.* as 75 ± 10 degrees: .* up to (\S+) m", printed)
    assert found and int(found[1]) > 80 and 0 < float(found[2]) < 0.5
