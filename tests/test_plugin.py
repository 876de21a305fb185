"""Plug-ins: another package's is opened with the daemon and called at its moments, in order."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import pytest

from edge.camera import Frame
from edge.config import AcceptanceConfig, Config, MapConfig, PageConfig, SamplingConfig, SequenceConfig, TelemetryConfig
from edge.daemon import Daemon
from edge.descriptor.network import Network
from edge.feed import FeedImages, read_feed
from edge.journal.records import PlaceFix
from edge.opened_parts import OpenedParts
from edge.plugin import PLUGINS, plugin_openers
from sim.journal import records_of
from tests.faults.simulated_daemon import ScriptedFrames
from tests.udp_port import free_port

FRAMES, PERIOD_NS = 60, 200_000_000
OTHERS = '''
"""A plug-in of another package: keeps what it was called for."""
from edge.plugin import Plugin

class Witness(Plugin):
    def __init__(self):
        self.seen = []
    def start(self):
        self.seen.append("start")
    def frame(self, frame):
        self.seen.append(("frame", frame.index))
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


@pytest.mark.usefixtures("installed")
def test_a_plug_in_of_another_package_is_called_at_its_moments(
    make_street: Callable[..., Path], network: Network, tmp_path: Path
) -> None:
    street = make_street(range(FRAMES), period_ms=PERIOD_NS // 1_000_000)
    now_ns, images = 10**12, FeedImages(read_feed(street / "feed"))
    frames, journal = ScriptedFrames(lambda: now_ns), tmp_path / "events.jsonl"
    config = Config(
        sampling=SamplingConfig(by="frames"),
        map=MapConfig(path=str(street / "map")),
        sequence=SequenceConfig(length=10),
        acceptance=AcceptanceConfig(window_m=10.0, hold_off_s=0.2),
        telemetry=TelemetryConfig(connection=f"udpin:127.0.0.1:{free_port()}", journal=str(journal)),
        page=PageConfig(port=0),
    )
    with ExitStack() as parts:
        opened = OpenedParts(config, parts, lambda: now_ns, frames=frames, network=network)
        (witness,) = [plugin for plugin in opened.plugins if type(plugin).__name__ == "Witness"]
        daemon = Daemon(opened)
        for index in range(FRAMES):
            now_ns += PERIOD_NS
            frames.next = Frame(images.read(index), now_ns, index)
            daemon.turn()
        daemon.turn()  # without a frame
        daemon.reopen_maps()
        daemon.last_words()
    seen = witness.seen  # type: ignore[attr-defined]
    assert (seen[0], seen[-4:]) == ("start", ["turn", "maps_changed", "stop", "close"])
    assert seen.count("turn") == FRAMES + 1
    assert seen.count("spare_turn") == 1
    places = [fix.place for fix in records_of(journal, PlaceFix)]
    assert places
    assert [one[1] for one in seen if one[0] == "place"] == places
    assert [one[1] for one in seen if one[0] == "frame"] == list(range(FRAMES))
    emitted = seen.index(("place", places[0]))
    assert [one[0] for one in seen[emitted - 2 : emitted + 1]] == ["frame", "frame_used", "place"]
    assert seen[emitted - 1][2], "the record says that an event followed"


def test_those_that_come_with_lookback_can_all_be_loaded() -> None:
    openers = list(plugin_openers())
    assert len(openers) >= len(PLUGINS)
    assert all(callable(opener) for opener in openers)
