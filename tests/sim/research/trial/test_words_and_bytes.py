"""By what the vehicle steers and what was sent, as people read it, against the bytes of recorded drives."""

from __future__ import annotations

import math
import re
from collections import Counter
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, get_args

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from edge.config import FIRST_NETWORK
from edge.daemon import Daemon
from edge.descriptor.network import Network
from edge.journal.records import SteeringChanged
from edge.telemetry import LinkStatus
from edge.telemetry.codec import Message
from edge.telemetry.encoders import CARRIERS, EXTERNAL_POSITION_ESTIMATE
from edge.telemetry.steering import CONFIRMED_NS, GpsUse, SteeredBy, Steering
from edge_plugins.page.metrics import _link_metrics
from sim.journal import records_of
from sim.research.trial import replayed_drive
from sim.research.trial.recorded_drive import WE, LinkFrame, read_drive
from sim.research.trial.replayed_drive import Playback, replay
from sim.trial.run import JOURNAL
from sim.trial.views import RoadLibrary
from tests.common import ROOT, S

SHORT = "flights_b06f79e/ardupilot_person914"
DRIVES = (
    *(f"flights_386c0d62/ardupilot_{name}" for name in ("a971", "spoofjam975", "copter970")),
    *(f"flights_87e80ff9/{name}" for name in ("ardupilot_fused_974", "px4_p979")),
    *(f"flights_b06f79e/{name}" for name in ("ardupilot_kill9_914", "px4_aided_mission_296_w921")),
    "flights_b0903bde/ardupilot_spoofA971",
    "flights_eca2e43/ardupilot_reboot952",
)
"""Of 1 km most, each a minute of a processor: the short one guards a change, all of them a release."""
FOLLOWED_S = 5.0
"""From when a position has left until its autopilot is found to agree."""


def is_position(message: Message) -> bool:
    command = getattr(message, "command", EXTERNAL_POSITION_ESTIMATE)
    return message.get_type() in CARRIERS and command == EXTERNAL_POSITION_ESTIMATE


class Reader:
    """Reads page and metrics once a second, beside the cable."""

    def __init__(self, drive: list[LinkFrame]) -> None:
        own = [one for one in drive if one.message.get_srcComponent() != WE and one.message.get_type() == "GPS_RAW_INT"]
        self._fixes = [(one.time_s, one.message.fix_type >= mavlink.GPS_FIX_TYPE_3D_FIX) for one in own]
        self.states: list[Steering] = []
        self._playback: Playback | None = None
        self._due_s, self._read = 0.0, 0

    def __call__(self, daemon: Daemon, playback: Playback) -> None:
        if (now_s := playback.now_ns / 1e9) < self._due_s:
            return
        link, self._due_s = daemon.parts.autopilot.status(), now_s + 1.0
        if playback is not self._playback:
            self._playback, self._read, self._before = playback, 0, link
            self._counts, self._newest_s = Counter[str](), -math.inf
        for at_s, one in playback.received[self._read :]:
            if is_position(one):
                self._counts[one.get_type()] += 1
                self._newest_s = at_s
        self._read = len(playback.received)
        for name in CARRIERS:  # what has left in this turn arrives in the next one
            assert self._before.sent.get(name, 0) <= self._counts[name] <= link.sent.get(name, 0)
        self._before = link
        state = Steering(link.gps_use, link.steers_by)  # type: ignore[arg-type]
        self.states.append(state)
        self._check_metrics(link)
        if state.by == "places":
            assert now_s - self._newest_s <= CONFIRMED_NS / S + FOLLOWED_S
        fixes = [good for at_s, good in self._fixes if now_s - 8.0 <= at_s <= now_s]
        if link.state == "up" and len(fixes) > 3 and len(set(fixes)) == 1:  # for some seconds
            assert fixes[0] or (state.gps in ("lost", "unknown") and state.by != "GPS"), f"{now_s:.1f} s: {state}"
            assert not fixes[0] or state.gps != "lost", f"{now_s:.1f} s: {state}"

    def _check_metrics(self, link: LinkStatus) -> None:
        status: Any = SimpleNamespace(link=link, no_pose_m=None, stamp_ns=0, beside_lane_m=None)
        found = {(one.name, *one.labels.values()): one.value for kind in _link_metrics(status) for one in kind.samples}
        assert {by for by in get_args(SteeredBy) if found["lookback_steering", by]} == {link.steers_by}
        assert {use for use in get_args(GpsUse) if found["lookback_gps_use", use]} == {link.gps_use}
        sent = {name: found.get(("lookback_positions_sent_total", name), 0.0) for name in CARRIERS}
        assert sent == {name: link.sent.get(name, 0) for name in CARRIERS}


@pytest.mark.parametrize(
    "name",
    [pytest.param(SHORT, marks=pytest.mark.long), *(pytest.param(one, marks=pytest.mark.soak) for one in DRIVES)],
)
def test_what_people_read_is_what_the_autopilot_heard(
    name: str, shared: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not (shared / name).is_dir():
        pytest.skip(f"needs the recorded drive {shared / name}")
    drive = read_drive(shared / name)
    if name == SHORT:  # 204 poses in place of 223, and each state; 37 s of a processor in place of 93
        monkeypatch.setattr(replayed_drive, "MOST_OF_PLACE", 80)
        drive = replace(drive, runs=[run._replace(exposures_s=run.exposures_s[::2]) for run in drive.runs])
    reader = Reader(drive.link)
    with closing(RoadLibrary(Network.load(Path(FIRST_NETWORK)), tmp_path / "views")) as library:
        heard = replay(drive, drive.used, tmp_path / "now", library, keypoints=True, watch=reader)
    changes: Any = records_of(tmp_path / "now" / JOURNAL, SteeringChanged)
    journaled = [str(Steering(one.gps, one.by)) for one in changes]
    texts = [one.text.removeprefix("Lookback: ") for _, one in heard if one.get_type() == "STATUSTEXT"]
    read = [one for one in texts if re.match("GPS .*(steers by|position unknown)", one)]
    # GPS in use at the start is no news to the pilot. Of many lines the newest are sent, and the last may wait.
    in_order = iter(journaled)
    assert all(one in in_order for one in read) and len(read) >= len(journaled) - 2 * len(drive.runs)
    assert set(journaled) <= set(map(str, reader.states))


def test_the_page_has_the_words_of_the_pilot_the_journal_and_nmea() -> None:
    page = (ROOT / "edge_plugins/page/page.html").read_text("utf-8")
    (found,) = re.findall(r"const GPS_USES = {(.*)};", page)
    words = dict(re.findall(r'"?([a-z][a-z ]*)"?: "([^"]*)"', found))
    assert words.keys() == set(get_args(GpsUse))
    assert '(by === "unknown" ? "position unknown" : `steers by ${by}`)' in page
    for use, spelled in words.items():
        assert str(Steering(use)) == f"{spelled}, position unknown"
        assert str(Steering(use, "places")) == f"{spelled}, steers by places"
