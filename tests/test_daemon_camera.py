"""A daemon whose config has another field of view than its camera: once it is seen, people and the journal have it."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from edge.descriptor.network import Network
from tests.golden.harness import CASE, JOURNAL, RECORDINGS, SENT, SETTINGS, cases, run_case

HOME = next(case for case in cases("run") if case.name == "home_without_gps")


@pytest.mark.parametrize("fov_deg", [66.0, pytest.param(80.0, marks=pytest.mark.long)])
def test_a_wrong_field_of_view_is_told_once_and_a_right_one_never(
    fov_deg: float, tmp_path: Path, network: Network
) -> None:
    case = tmp_path / "case"
    shutil.copytree(HOME, case)
    settings = (case / SETTINGS).read_text()
    (case / SETTINGS).write_text(settings.replace("[camera]", f"[camera]\nfov_deg = {fov_deg}"))
    of_map = '{ street = ["out_first", "out_second"] }\nbuild = ["--fov-deg", "80"]'
    (case / CASE).write_text(f'query = "home_night"\nmaps = {of_map}\n')
    made = run_case(case, tmp_path, network, own=tmp_path / "run")
    records = [json.loads(line) for line in made[JOURNAL].splitlines()]
    found = [one for one in records if one["event"] == "camera_differs"]
    texts = [text for line in made[SENT].splitlines() if "camera sees" in (text := json.loads(line).get("text", ""))]
    assert (RECORDINGS / "home_night").exists()
    assert len(found) == len(texts) == (fov_deg != 80.0)
    for one, text in zip(found, texts, strict=True):
        assert one["configured_deg"] == 66.0
        assert one["fov_deg"] == pytest.approx(80.0, abs=4 * one["fov_sigma_deg"]) == pytest.approx(80.0, abs=6.0)
        assert float(text.split()[2]) == pytest.approx(one["fov_deg"], abs=0.051)
        assert text.startswith("camera sees ") and text.endswith("; config 66")
