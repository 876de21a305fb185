"""Plug-ins are guests: another package's is opened where the config has its section, and costs nothing but itself."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.__main__ import main
from edge.camera import Frame
from edge.config import SHIPPED, Config, load_config
from edge.daemon import Daemon
from edge.descriptor.network import Network
from edge.errors import ConfigError
from edge.feed import FeedImages, read_feed
from edge.journal.records import PlaceFix, PluginFailed, Stopped
from edge.opened_parts import OpenedParts
from edge.telemetry import open_link
from edge.telemetry.codec import MavlinkCodec
from sim.journal import UnknownRecord, read_journal, records_of
from tests.faults.simulated_daemon import ScriptedFrames
from tests.udp_port import free_port

FRAMES, PERIOD_NS = 60, 200_000_000
OTHERS = '''
"""Plug-ins of another package: each keeps what it was called for, and fails where it is told to."""
import sys
from typing import Annotated, ClassVar, Literal
import numpy as np
from msgspec import Meta
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from edge.config import FilePath, Section
from edge.journal.records import Record, unit
from edge.plugin import Plugin
from edge.reference_map import PartialMap
from edge.telemetry.position_history import ExposureQueue

class WitnessConfig(Section, frozen=True):
    """[witness]: keeps what it is called for."""
    plugin: ClassVar[str] = "lookback_witness:Witness"
    fails: str = ""
    loud: Annotated[float, Meta(ge=0, le=11)] = 5.0
    file: FilePath = ""
    def asks(self, config):
        return self.loud > 0

class OtherConfig(WitnessConfig, frozen=True):
    """[other]"""
    plugin: ClassVar[str] = "lookback_witness:Other"

class WitnessCalled(Record, frozen=True, tag="witness_called"):
    """A frame was shown to it."""
    frame: Annotated[int, unit("", "its index")]
    by: Annotated[object, unit("", "what")] = None

class Witness(Plugin):
    def __init__(self, config, parts):
        self.config, self.parts, self.seen, self.newest = config, parts, [], None
        self.service = self
        self.awaiting = ExposureQueue(parts.autopilot.history)
        self.call("open")
    def call(self, what):
        self.seen.append(what)
        if what == self.config.fails:
            raise KeyError(what)
    def start(self):
        self.call("start")
    def frame(self, frame):
        if self.config.fails in INTRUSIONS:
            INTRUSIONS[self.config.fails](self, frame)
        self.parts.record(WitnessCalled(frame.index, self if self.config.fails == "record" else None))
        self.seen.append(("frame", frame.index))
        if frame.index == 20:
            self.call("frame 20")
            self.parts.plugins.ask("other", lambda other: other.call("asked"))
        self.awaiting.add(frame.stamp_ns, frame)
    def newest_map(self):
        return self.newest
    def frame_used(self, used):
        assert not used.frame.image.flags.writeable
        self.seen.append(("frame_used", used.frame.index, used.record.emitted, used.place and used.place.place))
    def turn(self, spare_s):
        self.seen.append("turn" if spare_s is None else "spare turn")
        for frame, position in self.awaiting.known():
            self.call("position")
    def read(self, message, now_ns, *, is_for_us):
        self.call("read")
        return []
    def due(self, now_ns):
        self.call("due")
        return ["no message"] if self.config.fails == "message" else []
    def abandon(self, now_ns):
        self.call("abandon")
        return [mavlink.MAVLink_mission_ack_message(1, 1, 15)]
    def close(self):
        self.call("close")

class Other(Witness):
    pass

def broken_map(self, frame):
    maps = self.parts.recognizer.map_set
    one = maps.maps[0]
    places = np.zeros(one.header.places, [("lat", "f8")])
    fields = dict(vars(one), places=places, path=one.path / "drive")
    self.newest = PartialMap(**fields, matcher=maps.matchers[0], mean=None, deviation=None, thumbnails=None)

INTRUSIONS = {
    "paints": lambda self, frame: frame.image.fill(0),
    "unlocks": lambda self, frame: setattr(frame.image.flags, "writeable", True),
    "paints below": lambda self, frame: frame.image.base.__setitem__(slice(None), 0),
    "resets": lambda self, frame: self.parts.recognizer.reset(),
    "joins the link": lambda self, frame: self.parts.autopilot.serve(object()),
    "broken map": broken_map,
    "another map": lambda self, frame: setattr(self, "newest", object()),
    "exits": lambda self, frame: sys.exit(3),
}

def nothing():
    return None
'''
POINTS = """witness = lookback_witness:WitnessConfig
other = lookback_witness:OtherConfig
broken = lookback_missing:BrokenConfig
absent = lookback_witness:missing
wrong = lookback_witness:nothing
"""


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Another package, as pip would leave it; the list of its plug-ins, of which some are broken."""
    site = tmp_path / "site"
    info = site / "lookback_witness-1.0.dist-info"
    info.mkdir(parents=True)
    (site / "lookback_witness.py").write_text(OTHERS)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: lookback-witness\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[lookback.plugins]\n{POINTS}")
    monkeypatch.syspath_prepend(site)
    monkeypatch.delitem(sys.modules, "lookback_witness", raising=False)
    return info / "entry_points.txt"


class Street:
    """A daemon on a map of a street, which is shown one frame after another; its autopilot says little."""

    def __init__(self, config: Config, street: Path, network: Network, parts: ExitStack) -> None:
        self._now_ns, self._images = 10**12, FeedImages(read_feed(street / "feed"))
        self._frames, self.journal = ScriptedFrames(self.clock_ns), Path(config.telemetry.journal)
        self._link = parts.enter_context(closing(open_link(config.telemetry.connection.replace("udpin", "udp"))))
        self.opened = OpenedParts(config, parts, self.clock_ns, frames=self._frames, network=network)
        self.witness: Any = self.opened.plugins.ask("witness", lambda one: one)
        self.other: Any = self.opened.plugins.ask("other", lambda one: one)
        self.daemon = Daemon(self.opened)

    def clock_ns(self) -> int:
        return self._now_ns

    def drive(self) -> list[int]:
        """All frames, and a turn without one; the places that were published."""
        heartbeat = MavlinkCodec(1, 1).encode(mavlink.MAVLink_heartbeat_message(10, 3, 0, 0, 4, 3))
        for index in range(FRAMES):
            self._now_ns += PERIOD_NS
            self._frames.next = Frame(self._images.read(index), self._now_ns, index)
            if index % 10 == 9:
                assert self._link.send(heartbeat)
            self.daemon.turn()
        self.daemon.turn()
        self.daemon.last_words()
        assert self.opened.journal is not None
        self.opened.journal.close()
        assert [one.frames_used for one in records_of(self.journal, Stopped)] == [FRAMES]
        return [fix.place for fix in records_of(self.journal, PlaceFix)]

    def heard(self, kind: str) -> list[Any]:
        """What the autopilot has received of a kind of message."""
        data = b"".join(iter(self._link.receive, b""))
        return [one for one in MavlinkCodec(255, 190).decode(data) if one.get_type() == kind]


@pytest.fixture
def config_of(make_street: Callable[..., Path], tmp_path: Path) -> Callable[[str], Config]:
    """The config of a drive on a street, from a file, with further sections."""
    street = make_street(range(FRAMES), period_ms=PERIOD_NS // 1_000_000)

    def make(sections: str) -> Config:
        file = tmp_path / "lookback.toml"
        file.write_text(
            f'[sampling]\nby = "frames"\n[map]\npath = "{street}/map"\n[sequence]\nlength = 10\n'
            f"[acceptance]\nwindow_m = 10.0\nhold_off_s = 0.2\n[page]\nport = 0\n"
            f'[telemetry]\nconnection = "udpin:127.0.0.1:{free_port()}"\njournal = "events.jsonl"\n{sections}'
        )
        return load_config(file)

    return make


@pytest.fixture
def parts() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


@pytest.fixture
def open_street(
    config_of: Callable[[str], Config], make_street: Callable[..., Path], grid: Network, parts: ExitStack
) -> Callable[[str], Street]:
    street = make_street(range(FRAMES), period_ms=PERIOD_NS // 1_000_000)
    return lambda sections: Street(config_of(sections), street, grid, parts)


OpenStreet = Callable[[str], Street]


@pytest.fixture
def whole(open_street: OpenStreet) -> list[int]:
    """The places that are published without any plug-in."""
    street = open_street("")
    places = street.drive()
    street.journal.unlink()
    assert len(places) > 3
    return places


def test_it_is_called_at_its_moments_in_order(installed: Path, open_street: OpenStreet) -> None:
    street = open_street("[witness]\n")
    places = street.drive()
    seen = street.witness.seen
    assert (seen[:2], seen[-4:]) == (["open", "start"], ["due", "spare turn", "abandon", "close"])
    assert (seen.count("turn"), seen.count("spare turn"), seen.count("due")) == (FRAMES, 1, FRAMES + 1)
    assert seen.count("read") >= 5
    assert [one[1] for one in seen if one[0] == "frame"] == list(range(FRAMES))
    used = [one for one in seen if one[0] == "frame_used"]
    assert [one[1] for one in used] == list(range(FRAMES))
    assert [one[3] for one in used if one[3] is not None] == places
    assert all(one[2] == (one[3] is not None) for one in used), "the record says whether an event follows"
    assert street.heard("MISSION_ACK"), "its last words"
    assert street.other is None
    assert not list(records_of(street.journal, PluginFailed))


@pytest.mark.parametrize(
    ("fails", "why"),
    [
        ("frame 20", "KeyError: 'frame 20'"),
        ("position", "KeyError: 'position'"),
        ("read", "KeyError: 'read'"),
        ("due", "KeyError: 'due'"),
        ("message", "AttributeError"),
        ("record", "TypeError"),
        ("paints", "ValueError: assignment destination is read-only"),
        ("unlocks", "ValueError: cannot set WRITEABLE flag"),
        ("paints below", "ValueError: assignment destination is read-only"),
        ("resets", "AttributeError: 'RecognizerView' object has no attribute 'reset'"),
        ("joins the link", "RuntimeError: the link has a service"),
        ("broken map", "ValueError: newest_map: has other places"),
        ("another map", "TypeError: newest_map: object is no map of a drive"),
        ("exits", "SystemExit: 3"),
    ],
)
def test_one_that_fails_is_gone_and_costs_nothing_else(
    fails: str, why: str, installed: Path, open_street: OpenStreet, whole: list[int], caplog: pytest.LogCaptureFixture
) -> None:
    """Wherever: at a moment, with a frame that waited for its position, in what it exchanges with the autopilot."""
    street = open_street(f'[witness]\nfails = "{fails}"\n[other]\n')
    assert street.drive() == whole
    (failed,) = records_of(street.journal, PluginFailed)
    assert failed.plugin == "witness"
    assert failed.why.startswith(why)
    assert ".py:" in failed.why, "where"
    assert street.witness.seen[-2:] == ["abandon", "close"]
    assert street.witness.seen.count("abandon") == 1, "closed is gone"
    assert street.other.seen[-4:] == ["due", "spare turn", "abandon", "close"]
    (line,) = (one.getMessage() for one in caplog.records if one.levelname == "ERROR")
    assert line == f"plug-in witness failed and is closed; everything else goes on: {failed.why}"
    assert "Traceback" not in caplog.text
    assert any("witness failed" in one.text for one in street.heard("STATUSTEXT")) or fails in ("due", "message")


def test_one_that_fails_when_another_asks_it_is_closed_and_not_the_other(
    installed: Path, open_street: OpenStreet, whole: list[int]
) -> None:
    street = open_street('[witness]\n[other]\nfails = "asked"\n')
    assert street.drive() == whole
    assert [one.plugin for one in records_of(street.journal, PluginFailed)] == ["other"]
    assert street.witness.seen.count("due") == FRAMES + 1


def test_one_that_fails_at_the_end_does_not_end_what_follows(installed: Path, open_street: OpenStreet) -> None:
    street = open_street('[witness]\nfails = "close"\n[other]\nfails = "abandon"\n')
    street.drive()
    assert {one.plugin for one in records_of(street.journal, PluginFailed)} == {"witness", "other"}
    assert street.other.seen[-1] == "close"


def test_what_the_config_does_not_name_is_not_even_imported(installed: Path, open_street: OpenStreet) -> None:
    street = open_street("")
    assert "lookback_witness" not in sys.modules, "of its plug-ins some are broken"
    assert street.witness is None


def test_a_section_may_ask_for_nothing(installed: Path, open_street: OpenStreet) -> None:
    assert open_street("[witness]\nloud = 0.0\n").witness is None


@pytest.mark.parametrize(
    ("section", "why"),
    [
        ("[broken]", "[broken] plug-in broken (lookback_missing:BrokenConfig): ModuleNotFoundError"),
        ("[absent]", "[absent] plug-in absent (lookback_witness:missing): AttributeError"),
        ("[wrong]", "[wrong] plug-in wrong (lookback_witness:nothing): the entry point must name its Section"),
        ('[witness]\nfails = "open"', "[witness] plug-in witness (lookback_witness:Witness): KeyError: 'open'"),
        ('[witness]\nfails = "start"', "[witness] plug-in witness (Witness): KeyError: 'start'"),
        ("[witness]\nquiet = 1", "[witness] unknown key `quiet`"),
        ("[witness]\nloud = 12", "[witness] loud: expected a number <= 11"),
        ("[witnes]", "unknown section `witnes`"),
        ("[motions]", "unknown section `motions`"),
    ],
)
def test_what_is_wrong_with_one_that_the_config_names_is_one_line(
    section: str, why: str, installed: Path, open_street: OpenStreet
) -> None:
    with pytest.raises(ConfigError) as caught:
        open_street(section)
    assert why in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_name_that_two_have_is_only_wrong_where_the_config_uses_it(
    installed: Path, config_of: Callable[[str], Config]
) -> None:
    installed.write_text("[lookback.plugins]\nhome = lookback_witness:WitnessConfig\n")
    config_of("")
    with pytest.raises(ConfigError, match=r"\[home\] plug-in home: .* have this name; uninstall one of them"):
        config_of("[home]\nenabled = true\n")


def test_its_section_has_paths_as_the_others_have(
    installed: Path, config_of: Callable[[str], Config], tmp_path: Path
) -> None:
    config = config_of('[witness]\nfile = "names.txt"\n')
    assert config.plugins["witness"].file == str(tmp_path / "names.txt")  # type: ignore[attr-defined]
    with pytest.raises(ConfigError, match=r"\[witness\] file: .*neither a file nor a folder"):
        config_of('[witness]\nfile = "/dev/null"\n')


def test_its_keys_are_listed_with_all_others(installed: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["config", "--all"]) == 0
    listed = capsys.readouterr().out
    assert '[witness]  # [witness]: keeps what it is called for.\nfails = ""\nloud = 5.0\nfile = ""\n' in listed
    assert "# [broken] plug-in broken (lookback_missing:BrokenConfig): ModuleNotFoundError" in listed


def test_its_records_are_in_the_journal_and_readable_without_it(installed: Path, open_street: OpenStreet) -> None:
    street = open_street("[witness]\n")
    street.drive()
    called = list(records_of(street.journal, import_module("lookback_witness").WitnessCalled))
    assert [one.frame for one in called] == list(range(FRAMES))
    others = [line.record for line in read_journal(street.journal) if isinstance(line.record, UnknownRecord)]
    assert [one.fields["frame"] for one in others if one.fields["event"] == "witness_called"] == list(range(FRAMES))


def test_those_that_come_with_lookback_can_all_be_loaded() -> None:
    for point in SHIPPED.values():
        module, _, name = point.load().plugin.partition(":")
        assert callable(getattr(import_module(module), name))
