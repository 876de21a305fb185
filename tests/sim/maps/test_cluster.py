"""`lookback map build --cluster`: the bytes of one computer, whoever described the recordings."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.__main__ import main
from edge.config import Config, DescriptorConfig, SamplingConfig
from edge.descriptor.network import Network
from edge.errors import MapError
from edge.feed import FeedOptions
from edge.recognition.recognizer import model_key
from edge.reference_map import RegionsKey, read_header
from edge_plugins.mapping.builder import MapBuilder
from sim.maps.describing import Work, add_by_cluster

distributed = pytest.importorskip("distributed", reason="needs the extra `cluster`")


@pytest.fixture(scope="module")
def feeds(make_street: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Three recordings of one street, of different lengths."""
    folder = tmp_path_factory.mktemp("feeds")
    feed = make_street(range(12)) / "feed"
    found = [Path(shutil.copytree(feed, folder / f"{number}")) for number in range(3)]
    for number, one in enumerate(found):
        text = (one / "feed.toml").read_text()
        text = text.replace("odometer = false", f"odometer = {'false' if number == 1 else 'true'}")
        (one / "feed.toml").write_text(text.replace('name = "', f'name = "{number} '))
    rows = (found[2] / "frames.csv").read_text().splitlines()
    at = rows[0].split(",").index("distance_m")
    last = rows[-1].split(",")
    (found[2] / "frames.csv").write_text("\n".join([*rows[:-1], ",".join([*last[:at], "", *last[at + 1 :]])]) + "\n")
    return found


@pytest.fixture(params=[False, pytest.param(True, marks=pytest.mark.soak)], ids=["threads", "processes"])
def address(request: pytest.FixtureRequest) -> Iterator[str]:
    workers: dict[str, Any] = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None}
    workers["scheduler_kwargs"] = {"dashboard_address": ":0"}  # without it, every scheduler asks for port 8787
    with distributed.LocalCluster(processes=request.param, **workers) as cluster:
        yield cluster.scheduler_address


def test_a_cluster_makes_the_map_that_one_computer_makes(
    feeds: list[Path], address: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["map", "build", *map(str, feeds), "--spacing-frames", "3", "-o"]
    assert main([*command, str(tmp_path / "alone")]) == 0
    assert main([*command, str(tmp_path / "together"), "--cluster", address]) == 0
    assert "dashboard: " in capsys.readouterr().out
    moved = [segment.moved_as_driven for segment in read_header(tmp_path / "alone").segments]
    assert moved == [True, False, False], "the last lacks a distance, so its meters are of its positions"
    files = sorted(file.name for file in (tmp_path / "alone").iterdir())
    assert {name: (tmp_path / "together" / name).read_bytes() for name in files} == {
        name: (tmp_path / "alone" / name).read_bytes() for name in files
    }


def test_what_cannot_be_built_is_one_line(
    feeds: list[Path], address: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(feeds[0], tmp_path / "feed")
    for file in (tmp_path / "feed/frames").iterdir():
        file.write_bytes(file.read_bytes()[:10])
    assert main(["map", "build", str(tmp_path / "feed"), "-o", str(tmp_path / "map"), "--cluster", address]) == 78
    assert "a map needs at least 2 places" in capsys.readouterr().err.splitlines()[-1]
    assert not (tmp_path / "map").exists()


class OtherProcessor(Network):
    """Rounds otherwise."""

    def describe(self, images: NDArray[np.uint8]) -> NDArray[np.float32]:
        return super().describe(images) * np.float32(1.000001)


def test_a_worker_that_describes_otherwise_is_not_used(feeds: list[Path], address: str, tmp_path: Path) -> None:
    network, sampling = OtherProcessor.load(), SamplingConfig(by="frames")
    with MapBuilder(tmp_path / "map", model_key(network), RegionsKey.of(DescriptorConfig()), sampling) as builder:
        work = Work(Config(), FeedOptions(), sampling, must_have_distance=False)
        with pytest.raises(MapError, match="otherwise than this computer"):
            add_by_cluster(builder, network, feeds, work, address)


@pytest.mark.soak
def test_a_scheduler_that_is_not_there_is_named(
    feeds: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    nowhere = "tcp://127.0.0.1:1"
    assert main(["map", "build", str(feeds[0]), "-o", str(tmp_path / "map"), "--cluster", nowhere]) == 78
    assert f"no scheduler at {nowhere}" in capsys.readouterr().err.splitlines()[-1]
