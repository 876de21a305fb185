"""A daemon whose config has another field of view than its camera: once it is seen, people and the journal have it."""

from __future__ import annotations

import contextlib
import json
import shutil
import socket
import threading
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

pytest.importorskip("starlette")

from edge.descriptor.network import Network
from tests.golden.harness import CASE, JOURNAL, RECORDINGS, SENT, SETTINGS, cases, run_case
from tests.udp_port import free_port

HOME = next(case for case in cases("run") if case.name == "home_without_gps")


@contextlib.contextmanager
def shown_on(port: int) -> Iterator[dict[str, float]]:
    """What the daemon's page shows meanwhile of the camera by keypoints: the newest there is at the end."""
    shown: dict[str, float] = {}
    ended = threading.Event()

    def read() -> None:
        while not ended.wait(0.2):
            with contextlib.suppress(OSError), urllib.request.urlopen(f"http://127.0.0.1:{port}/status.json") as answer:
                shown.update(json.load(answer)["camera_by_keypoints"] or {})

    reader = threading.Thread(target=read)
    reader.start()
    try:
        yield shown
    finally:
        ended.set()
        reader.join()


@pytest.mark.parametrize("fov_deg", [66.0, pytest.param(80.0, marks=pytest.mark.long)])
def test_a_wrong_field_of_view_is_told_once_and_a_right_one_never(
    fov_deg: float, tmp_path: Path, network: Network, make_once: Callable[..., Path]
) -> None:
    case = tmp_path / "case"
    shutil.copytree(HOME, case)
    settings, port = (case / SETTINGS).read_text(), free_port(socket.SOCK_STREAM)
    settings = settings.replace("[camera]", f"[camera]\nfov_deg = {fov_deg}")
    (case / SETTINGS).write_text(settings.replace("[page]\nport = 0", f"[page]\nport = {port}"))
    of_map = '{ street = ["out_first", "out_second"] }\nbuild = ["--fov-deg", "80"]'
    (case / CASE).write_text(f'query = "home_night"\nmaps = {of_map}\n')
    with shown_on(port) as shown:
        made = run_case(case, make_once("golden", lambda folder: None), network, own=tmp_path / "run")
    assert shown["configured_deg"] == fov_deg
    assert shown["fov_deg"] == pytest.approx(80.0, abs=4 * shown["fov_sigma_deg"])
    assert shown["k1"] == pytest.approx(0.0, abs=4 * shown["k1_sigma"])
    assert shown["is_another"] == (fov_deg != 80.0)
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
