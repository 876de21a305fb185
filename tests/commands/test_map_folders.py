"""The commands and the daemon with a folder of maps: lines name the map, and one that is damaged is left out."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import msgspec
import pytest
import tomli_w

from edge.__main__ import main
from edge.config import FIRST_NETWORK, MapConfig, SamplingConfig
from edge.descriptor.network import Network
from edge.feed import FeedImages, read_feed
from edge.journal.records import MapExcluded, PlaceFix
from edge.recognition.recognizer import open_recognizer
from edge.reference_map.map_folder import SIGNATURE, open_map_set
from edge.reference_map.store import DESCRIPTORS, PLACES, STATISTICS, open_map
from edge_plugins.page.snapshot import map_view
from sim.evaluation.replay import replay, with_options
from sim.journal import records_of
from sim.traverse import config_as_mapped
from tests.faults.simulated_daemon import DaemonRig, ScriptedFrames

FRAMES, BORDER, PERIOD_MS = 80, 64, 120
"""A daemon misses frames that come faster where the computer is busy with something else."""


@pytest.fixture(scope="module")
def street(write_traverse: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A map of a street, its two tiles, and another day on it."""
    folder = tmp_path_factory.mktemp("street")
    feed = write_traverse(folder / "out", range(FRAMES))
    write_traverse(folder / "again", range(FRAMES), noise=8.0, period_ms=PERIOD_MS)
    write_traverse(folder / "last", range(BORDER, FRAMES), noise=8.0, period_ms=PERIOD_MS)
    assert main(["map", "build", str(feed), "-o", str(folder / "map"), "--no-keypoints"]) == 0
    assert main(["map", "split", str(folder / "map"), "-o", str(folder / "tiles"), "--places", "50"]) == 0
    return folder


def damage(street: Path, folder: Path, name: str = DESCRIPTORS) -> Path:
    """The tiles, with a flipped bit in a file of the second."""
    tiles = Path(shutil.copytree(street / "tiles", folder / "tiles"))
    file = tiles / "1" / name
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    file.write_bytes(data)
    return tiles


@pytest.fixture
def damaged(street: Path, tmp_path: Path) -> Path:
    return damage(street, tmp_path)


def write_config(folder: Path, feed: Path, path: Path, **of_map: Any) -> Path:
    config = {
        "descriptor": {"model": FIRST_NETWORK},
        "camera": {"kind": "feed", "device": str(feed)},
        "sampling": {"by": "time", "interval_s": PERIOD_MS / 1000},
        "map": {"path": str(path), **of_map},
        "sequence": {"length": 10},
        "acceptance": {"uniqueness_min": 1.02, "window_m": 10.0, "hold_off_s": 0.2},
        "telemetry": {"connection": "udp:127.0.0.1:9", "journal": "events.jsonl"},
        "page": {"port": 0},
    }
    (folder / "lookback.toml").write_text(tomli_w.dumps(config))
    return folder / "lookback.toml"


def replayed(street: Path, path: Path, capsys: pytest.CaptureFixture[str]) -> list[dict[str, Any]]:
    capsys.readouterr()
    command = ["replay", str(street / "again"), "--map", str(path), "--all", "--sequence-length", "10"]
    assert main([*command, "--spacing-frames", "1"]) == 0
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def test_a_folder_of_tiles_replays_as_the_map_does(street: Path, capsys: pytest.CaptureFixture[str]) -> None:
    whole, tiles = replayed(street, street / "map", capsys), replayed(street, street / "tiles", capsys)
    assert len(whole) == FRAMES
    answered = [line["place"] for line in whole if line["accepted"]]
    assert answered[-1] > BORDER + 10
    assert answered[0] < BORDER - 30
    for line, of_tile in zip(whole, tiles, strict=True):
        assert "map" not in line
        place = line.pop("place")
        assert (of_tile.pop("map", None), of_tile.pop("place")) == (
            (None, None) if place is None else ("0", place) if place < BORDER else ("1", place - BORDER)
        )
        assert line == of_tile


def test_nothing_is_told_of_a_damaged_tile(
    street: Path, damaged: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    lines = replayed(street, damaged, capsys)
    assert {line.get("map") for line in lines} == {None, "0"}
    (excluded,) = [record.message for record in caplog.records]
    assert excluded.startswith(f"{damaged / '1' / DESCRIPTORS}: damaged") and excluded.endswith("; excluded")
    assert sum(line["accepted"] for line in lines) > 30


@pytest.mark.parametrize("file", [PLACES, STATISTICS, "map.json"])
def test_a_tile_of_which_any_file_is_damaged_is_excluded(street: Path, tmp_path: Path, file: str) -> None:
    tiles = damage(street, tmp_path, file)
    maps = open_map_set(tiles, every_file=True)
    (excluded,) = maps.excluded
    assert maps.names == ("0",) and excluded.why.startswith(f"{tiles / '1' / file}: damaged")


def test_a_tile_that_is_opened_on_the_way_is_checked_before_it_is_told_of(
    street: Path, damaged: Path, grid: Network, caplog: pytest.LogCaptureFixture
) -> None:
    """Too large for a frame, so that the tiles are gone through: none is in use before a place of it is recognized."""
    config = with_options(config_as_mapped(open_map(street / "map").header), 16, None)
    acceptance = msgspec.structs.replace(config.acceptance, uniqueness_min=1.02, window_m=10.0)
    config = msgspec.structs.replace(config, map=MapConfig(places_per_frame=79), acceptance=acceptance)
    feed = read_feed(street / "again")

    def told(path: Path) -> list[str]:
        recognizer = open_recognizer(config, network=grid, map_set=open_map_set(path))
        lines = replay(recognizer, feed, SamplingConfig(by="frames"))
        return [str(line.map) for line, _ in lines if line.accepted]

    assert "1" in told(street / "tiles")
    assert not caplog.records
    assert "1" not in told(damaged)
    assert len(caplog.records) == 1


def test_the_daemon_goes_on_without_a_damaged_tile(
    street: Path, damaged: Path, grid: Network, caplog: pytest.LogCaptureFixture
) -> None:
    images = FeedImages(read_feed(street / "again"))
    with ExitStack() as parts:
        bench = DaemonRig(write_config(damaged.parent, street / "again", damaged), parts, grid, 10.0, ScriptedFrames)
        for number in range(FRAMES):
            bench.step(images.read(number), number)
        bench.daemon.last_words()
    journal = damaged.parent / "events.jsonl"
    (excluded,) = records_of(journal, MapExcluded)
    assert excluded.map == "1"
    assert f"{DESCRIPTORS}: damaged" in excluded.why
    assert sum("excluded" in record.message for record in caplog.records) == 1
    assert {place.map for place in records_of(journal, PlaceFix)} == {"0"}


def test_info_verify_and_check_of_a_folder(
    street: Path, damaged: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    capsys.readouterr()
    assert main(["map", "info", str(street / "tiles")]) == 0
    told = capsys.readouterr().out
    assert "80 places in 2 maps" in told
    assert "map       1: 16 places" in told
    assert main(["map", "info", str(street / "tiles" / "1")]) == 0
    assert "from its place 64 on" in capsys.readouterr().out
    assert main(["map", "verify", str(street / "tiles")]) == 0
    assert "all 10 checksums match" in capsys.readouterr().out
    assert main(["map", "verify", str(damaged)]) == 78
    out, err = capsys.readouterr()
    assert f"{DESCRIPTORS}: damaged" in out
    assert err.endswith("1 of its maps would be excluded: 1\n")
    assert main(["doctor", "--offline", str(write_config(tmp_path, street / "again", damaged))]) == 0
    out = capsys.readouterr().out
    assert "map of 64 places in 1 map" in out
    assert "damaged (checksum mismatch); build or copy the map again; excluded\n" in out


def test_each_map_of_a_folder_must_be_signed(street: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copytree(street / "tiles", tmp_path / "tiles")
    assert main(["map", "keygen", str(tmp_path / "owner")]) == 0
    assert main(["map", "sign", str(tmp_path / "tiles"), "--key", str(tmp_path / "owner")]) == 0
    config = write_config(tmp_path, street / "again", tmp_path / "tiles", require_signature_by="owner.pub")
    capsys.readouterr()
    assert main(["doctor", "--offline", str(config)]) == 0
    assert "map of 80 places in 2 maps" in capsys.readouterr().out
    (tmp_path / "tiles" / "0" / SIGNATURE).unlink()
    assert main(["doctor", "--offline", str(config)]) == 0
    out = capsys.readouterr().out
    assert "tiles/0: not signed" in out
    assert "map of 16 places in 1 map" in out
    (tmp_path / "tiles" / "1" / SIGNATURE).write_text("00" * 64)
    assert main(["doctor", "--offline", str(config)]) == 78
    assert "none of its 2 maps is usable" in capsys.readouterr().out


def test_the_page_shows_where_the_maps_are(street: Path) -> None:
    view = map_view(open_map_set(street / "tiles"))
    assert view.places == FRAMES
    (south, west), (_, east), (north, _), *_ = view.drives[1]
    assert south == pytest.approx(-27 + BORDER * 2 / 110_800)
    assert north == pytest.approx(-27 + 79 * 2 / 110_800)
    assert (west, east) == (153.0, 153.0)
    whole = open_map_set(street / "map")
    assert [view.thumbnail(place) for place in (0, 63, 64, 79)] == [whole.thumbnail(place) for place in (0, 63, 64, 79)]


def test_a_frame_says_which_map(street: Path, grid: Network) -> None:
    config = with_options(config_as_mapped(open_map(street / "map").header), 5, None)
    tiles = open_map_set(street / "tiles")
    recognizer = open_recognizer(config, network=grid, map_set=tiles)
    *_, (newest, _) = replay(recognizer, read_feed(street / "last"), SamplingConfig(by="frames"))
    assert (newest.map, newest.place) == ("1", FRAMES - BORDER - 1)
    assert map_view(tiles).starts == {"0": 0, "1": BORDER}


def test_splitting_is_refused_in_one_line(street: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for places, told in ((0, "--places: 0 is not between 1 and 79"), (80, "--places: 80 is not")):
        arguments = ["map", "split", str(street / "map"), "-o", str(tmp_path / "new"), "--places", str(places)]
        assert main(arguments) == 78
        assert told in capsys.readouterr().err
    command = ["map", "split", str(street / "map"), "-o", str(street / "tiles"), "--places", "40"]
    assert main(command) == 78
    assert "already exists" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


def test_a_tile_of_a_tile_follows_on(street: Path, tmp_path: Path) -> None:
    """What is cut again is still a piece of the first map, whatever else its folder holds."""
    assert main(["map", "split", str(street / "tiles" / "0"), "-o", str(tmp_path / "x"), "--places", "63"]) == 0
    (tmp_path / "x" / "0").rename(tmp_path / "x" / "0again")
    shutil.copytree(street / "tiles" / "1", tmp_path / "x" / "1")
    assert open_map_set(tmp_path / "x").index.segment(0) == (0, FRAMES)
    shutil.copytree(street / "map", tmp_path / "x" / "0between")
    assert open_map_set(tmp_path / "x").index.whole(0) == (0, BORDER)
