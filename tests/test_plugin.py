"""Plug-ins: another package's is opened with the daemon and called at its moments, in order."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from edge.camera import Frame
from edge.config import AcceptanceConfig, Config, MapConfig, PageConfig, SamplingConfig, SequenceConfig, TelemetryConfig
from edge.daemon import Daemon
from edge.descriptor.network import Network
from edge.errors import ConfigError
from edge.feed import FeedImages, read_feed
from edge.journal.records import PlaceFix, PluginFailed, Stopped
from edge.opened_parts import OpenedParts
from edge.plugin import PLUGINS, Plugins
from sim.journal import records_of
from tests.faults.simulated_daemon import ScriptedFrames
from tests.udp_port import free_port

FRAMES, PERIOD_NS = 60, 200_000_000
OTHERS = '''
"""A plug-in of another package: keeps what it was called for."""
from edge.plugin import Plugin

class Witness(Plugin):
    def __init__(self):
        self.seen, self.fails_at = [], None
    def start(self):
        self.seen.append("start")
    def frame(self, frame):
        self.seen.append(("frame", frame.index))
        if frame.index == self.fails_at:
            raise KeyError(frame.index)
    def spare_turn(self, waited_s, describe):
        self.seen.append("spare_turn")
    def frame_used(self, used):
        self.seen.append(("frame_used", used.frame.index, used.record.emitted))
    def place(self, fix):
        self.seen.append(("place", fix.place))
    def maps_changed(self):
        self.seen.append("maps_changed")
    def turn(self):
        self.seen.append("turn")
    def stop(self):
        self.seen.append("stop")
    def close(self):
        self.seen.append("close")

def open_plugin(parts):
    return Witness() if parts.config.map.path else None

def open_nothing(parts):
    return None
'''


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another package, as pip would leave it."""
    site = tmp_path / "site"
    info = site / "lookback_witness-1.0.dist-info"
    info.mkdir(parents=True)
    (site / "lookback_witness.py").write_text(OTHERS)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: lookback-witness\nVersion: 1.0\n")
    points = "witness = lookback_witness:open_plugin\nnothing = lookback_witness:open_nothing\n"
    (info / "entry_points.txt").write_text(f"[lookback.plugins]\n{points}")
    monkeypatch.syspath_prepend(site)
    monkeypatch.delitem(sys.modules, "lookback_witness", raising=False)


class Street:
    """A daemon on a map of a street, which is shown one frame after another."""

    def __init__(self, street: Path, network: Network, folder: Path, parts: ExitStack) -> None:
        self._now_ns, self._images = 10**12, FeedImages(read_feed(street / "feed"))
        self._frames, self.journal = ScriptedFrames(self.clock_ns), folder / "events.jsonl"
        connection = f"udpin:127.0.0.1:{free_port()}"
        config = Config(
            sampling=SamplingConfig(by="frames"),
            map=MapConfig(path=str(street / "map")),
            sequence=SequenceConfig(length=10),
            acceptance=AcceptanceConfig(window_m=10.0, hold_off_s=0.2),
            telemetry=TelemetryConfig(connection=connection, journal=str(self.journal)),
            page=PageConfig(port=0),
        )
        opened = OpenedParts(config, parts, self.clock_ns, frames=self._frames, network=network)
        self.witness: Any = opened.plugins.find(import_module("lookback_witness").Witness)
        self.daemon = Daemon(opened)

    def clock_ns(self) -> int:
        return self._now_ns

    def drive(self) -> None:
        for index in range(FRAMES):
            self._now_ns += PERIOD_NS
            self._frames.next = Frame(self._images.read(index), self._now_ns, index)
            self.daemon.turn()


@pytest.fixture
def open_street(make_street: Callable[..., Path], network: Network, tmp_path: Path, installed: None) -> Any:
    street = make_street(range(FRAMES), period_ms=PERIOD_NS // 1_000_000)
    return partial(Street, street, network, tmp_path)


def test_a_plug_in_of_another_package_is_called_at_its_moments(open_street: Callable[[ExitStack], Street]) -> None:
    with ExitStack() as parts:
        street = open_street(parts)
        street.drive()
        street.daemon.turn()  # without a frame
        street.daemon.reopen_maps()
        street.daemon.last_words()
    seen = street.witness.seen
    assert (seen[0], seen[-4:]) == ("start", ["turn", "maps_changed", "stop", "close"])
    assert seen.count("turn") == FRAMES + 1
    assert seen.count("spare_turn") == 1
    places = [fix.place for fix in records_of(street.journal, PlaceFix)]
    assert places
    assert [one[1] for one in seen if one[0] == "place"] == places
    assert [one[1] for one in seen if one[0] == "frame"] == list(range(FRAMES))
    emitted = seen.index(("place", places[0]))
    assert [one[0] for one in seen[emitted - 2 : emitted + 1]] == ["frame", "frame_used", "place"]
    assert seen[emitted - 1][2], "the record says that an event followed"


def test_a_plug_in_that_fails_costs_no_place(
    open_street: Callable[[ExitStack], Street], caplog: pytest.LogCaptureFixture
) -> None:
    with ExitStack() as parts:
        street = open_street(parts)
        street.drive()
    whole = [fix.place for fix in records_of(street.journal, PlaceFix)]
    street.journal.unlink()
    with ExitStack() as parts:
        street = open_street(parts)
        street.witness.fails_at = 20
        street.drive()
        street.daemon.last_words()
    (failed,) = records_of(street.journal, PluginFailed)
    assert (failed.plugin, failed.why) == ("witness", "KeyError: 20")
    assert street.witness.seen[-2:] == [("frame", 20), "close"]
    assert [fix.place for fix in records_of(street.journal, PlaceFix)] == whole
    assert "Traceback" in caplog.text
    assert next(records_of(street.journal, Stopped)).frames_used == FRAMES


@pytest.mark.parametrize(
    ("point", "why"),
    [
        ("page = lookback_witness:open_plugin", "page.*another has this name"),
        ("broken = lookback_missing:open_plugin", "broken.*ModuleNotFoundError.*uninstall"),
        ("broken = lookback_witness:missing", "broken.*AttributeError"),
    ],
)
def test_a_plug_in_that_is_not_usable_is_named(point: str, why: str, installed: None, tmp_path: Path) -> None:
    (tmp_path / "site/lookback_witness-1.0.dist-info/entry_points.txt").write_text(f"[lookback.plugins]\n{point}\n")
    with pytest.raises(ConfigError, match=why):
        Plugins(lambda name, why: None).open(None)


def test_those_that_come_with_lookback_can_all_be_loaded() -> None:
    assert all(callable(point.load()) for point in PLUGINS)
