"""`lookback map build` keeps keypoints, `map keypoints` adds them where there are none, and `map extend` keeps them."""

from __future__ import annotations

import re
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
    assert main(["map", "keypoints", str(built), str(out), "--fov-deg", "70"]) == 78
    assert "built: its drive again is of none of these recordings; name all" in capsys.readouterr().err
    assert main(["map", "keypoints", str(added), str(out), "--fov-deg", "130"]) == 78
    assert "--fov-deg: expected `float` <= 120" in capsys.readouterr().err


def test_the_field_of_view_is_that_of_the_config_the_recording_or_the_option(
    write_traverse: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (config := tmp_path / "lookback.toml").write_text("[camera]\nfov_deg = 60.0\n", encoding="utf-8")
    feed, recorded = write_traverse(tmp_path / "feed", range(4)), write_traverse(tmp_path / "recorded", range(4))
    with (recorded / "feed.toml").open("a", encoding="utf-8") as header:
        header.write("fov_deg = 70.0\n")

    def built(name: str, *options: str) -> float | None:
        assert main(["map", "build", *options, "-o", str(tmp_path / name)]) == 0
        key = open_map(tmp_path / name).header.keypoints_key
        return None if key is None else key.fov_deg

    assert built("none", str(feed)) == 75
    assert re.search('"focal_sigma": ?0.18', (tmp_path / "none/map.json").read_text())
    assert built("blind", str(write_traverse(tmp_path / "still", range(30), is_located=False))) is None
    assert "blind: without keypoints: its recordings have no positions, distances or" in capsys.readouterr().out
    assert built("config", str(feed), "--config", str(config)) == 60
    assert built("recording", str(recorded)) == 70
    assert built("both", str(recorded), "--config", str(config)) == 60
    assert built("option", str(feed), str(recorded), "--fov-deg", "50") == 50
    for options, why in (
        ([str(feed), "--config", str(config), "--fov-deg", "50"], "has [camera] fov_deg = 60; remove one of the two"),
        ([str(feed), str(recorded)], "a map with keypoints has one field of view; build several maps"),
    ):
        assert main(["map", "build", *options, "-o", str(tmp_path / "wrong")]) == 78
        assert why in capsys.readouterr().err
    assert main(["map", "keypoints", str(tmp_path / "blind"), str(tmp_path / "still")]) == 78
    assert "blind: without positions or distances, keypoints need a field of view; set" in capsys.readouterr().err
    assert main(["map", "extend", str(tmp_path / "config"), str(recorded)]) == 78
    assert "recorded: its pictures are 70 degrees wide, the map's 60" in capsys.readouterr().err
    assert main(["map", "extend", str(tmp_path / "config"), str(feed)]) == 0
    assert "its field of view is not known, and taken to be the map's, 60 degrees" in capsys.readouterr().out
