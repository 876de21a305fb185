"""`lookback map build` keeps keypoints, `map keypoints` adds them where there are none, and `map extend` keeps them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from edge.__main__ import main
from edge.reference_map.store import KEYPOINTS, open_map


def test_keypoints_are_built_by_default_and_added_later_to_the_same_bytes(
    write_traverse: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, again = (write_traverse(tmp_path / name, range(12), noise=noise) for name, noise in (("out", 0), ("again", 8)))
    built, added = tmp_path / "built", tmp_path / "added"
    assert main(["map", "build", str(out), "-o", str(built), "--fov-deg", "70"]) == 0
    assert main(["map", "build", str(out), "-o", str(added), "--no-keypoints"]) == 0
    assert open_map(added).keypoints is None
    assert main(["map", "keypoints", str(added), str(out), "--fov-deg", "70"]) == 0
    assert (added / KEYPOINTS).read_bytes() == (built / KEYPOINTS).read_bytes()
    assert main(["map", "verify", str(added)]) == 0
    assert main(["map", "info", str(added)]) == 0
    assert "keypoints 300 a place (22.8 kB), xfeat" in capsys.readouterr().out
    before = (built / KEYPOINTS).read_bytes()
    assert main(["map", "extend", str(built), str(again)]) == 0
    assert (built / KEYPOINTS).read_bytes()[: len(before)] == before
    assert main(["map", "keypoints", str(built), str(out)]) == 78
    assert "built: its drive again is of none of these recordings; name all" in capsys.readouterr().err
    assert main(["map", "keypoints", str(added), str(out), "--fov-deg", "130"]) == 78
    assert "--fov-deg: 130 is not a number of degrees from 30 to 120" in capsys.readouterr().err
