"""The coverage of the map on the page: computed by another process, kept, and never twice at once."""

from __future__ import annotations

import http.client
import json
import time
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("starlette")

from edge_plugins.page import PageConfig
from edge_plugins.page.server import StatusPage
from edge_plugins.page.snapshot import MapView, map_view
from tests.sim.coverage.roads import road, walk

LONGEST_S = 300.0


def ask(page: StatusPage, query: str) -> tuple[int, Any]:
    connection = http.client.HTTPConnection("127.0.0.1", page.port, timeout=60.0)
    with closing(connection):
        connection.request("GET", f"/coverage.json?{query}")
        answer = connection.getresponse()
        body = answer.read()
        return answer.status, json.loads(body) if answer.status == 200 else body.decode()


def wait(page: StatusPage, query: str) -> Any:
    end_s, done = time.monotonic() + LONGEST_S, [0.0]
    while (found := ask(page, query)[1])["state"] == "computing":
        assert time.monotonic() < end_s
        done.append(found["done"])
        time.sleep(0.2)
    assert done == sorted(done)
    return {**found, "done": done[-1]}


def test_it_is_computed_once_and_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And by nothing that lies in the working folder."""
    (tmp_path / "edge.py").write_text("raise SystemExit('not this one')")
    monkeypatch.chdir(tmp_path)
    maps = road(tmp_path / "map", [(0.0, walk(150, np.random.default_rng(7)))])
    with closing(StatusPage(PageConfig(port=0), map_view(maps))) as page:
        query = "for=again&light=day&view=front"
        assert ask(page, query)[1]["state"] == "computing"
        assert ask(page, "for=home&light=day&view=front")[1]["state"] == "busy"
        found = wait(page, query)
        assert found["state"] == "ready"
        assert 0 < found["done"] <= 1, "the bar has moved"
        stretches = found["sheet"]["stretches"]
        assert [one["from_m"] for one in stretches] == [0.0, 100.0, 200.0]
        assert stretches[2]["share"] > stretches[0]["share"]
        assert stretches[1]["line"][0] == pytest.approx([0.0, 100 / 110_574], abs=2e-5)
        assert ask(page, query)[1]["sheet"] == found["sheet"]


def test_what_fails_says_why_and_can_be_tried_again(tmp_path: Path) -> None:
    nothing = MapView(0, {}, (), lambda place: b"", tmp_path / "none.map")
    with closing(StatusPage(PageConfig(port=0), nothing)) as page:
        query = "for=home&light=night&view=rear"
        found = wait(page, query)
        assert (found["state"], found["sheet"]) == ("failed", None)
        assert "none.map" in found["why"]
        assert ask(page, query)[1]["state"] == "computing"  # and closing the page ends it


@pytest.mark.parametrize(
    ("query", "name"),
    [("light=day&view=front", "for"), ("for=home&light=noon&view=front", "light"), ("for=home", "light")],
)
def test_what_is_not_understood_is_refused(tmp_path: Path, query: str, name: str) -> None:
    with closing(StatusPage(PageConfig(port=0), MapView(0, {}, (), lambda place: b"", tmp_path))) as page:
        code, text = ask(page, query)
        assert code == 400
        assert text.startswith(f"{name}: not one of ")
