"""The live page's server: what it answers, what it refuses, and that it waits for nobody."""

from __future__ import annotations

import base64
import contextlib
import dataclasses
import http.client
import json
import re
import select
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
import pytest

pytest.importorskip("starlette")

from prometheus_client.parser import text_string_to_metric_families

from edge.camera import CameraHealth
from edge.journal.records import FrameUsed
from edge.telemetry import LinkStatus
from edge_plugins.page import PageConfig
from edge_plugins.page.metrics import STATES, as_metrics
from edge_plugins.page.server import StatusPage
from edge_plugins.page.snapshot import HistoryFrame, MapView, PageSnapshot, Status

CUT_OFF_S = 20.0
"""After this long the other side has not ended the connection; a busy machine takes its time."""
THUMBNAIL = cv2.imencode(".jpg", np.full((9, 12, 3), 90, np.uint8))[1].tobytes()
MAP = MapView(
    500,
    {"north": 0, "south": 300},
    (((1.0, 2.0), (1.001, 2.0)), ()),
    lambda place: THUMBNAIL if place < 400 else b"",
)


def snapshot(number: int) -> PageSnapshot:
    history = tuple(
        HistoryFrame(
            FrameUsed(k, 1000 * k, True, k == 2, place=k, uniqueness=1.1 + k / 100, confidence=k / 10), (1.0, 2.0)
        )
        for k in range(1, 4)
    )
    status = Status(
        stamp_ns=5000,
        started_unix_s=1.5,
        version="0",
        map_name="a map",
        model="a model",
        state="on the map",
        why="",
        newest=FrameUsed(4, 3000 + number, True, place=7, map="south", uniqueness=1.2, confidence=0.9),
        searched=(0.0, 80.0, "m"),
        frames_used=number,
        events=1,
        fps=4.0,
        confidence_from=0.92,
        stages_ms={"network": 9.5},
        journal_lost=0,
        camera=CameraHealth("running", "", 0, delivered=10, overwritten=2, bad=1),
        link=LinkStatus("closed", "serial:/dev/none:57600", "report"),
        history=history,
    )
    image = np.full((480, 640, 3), (10, 120, 240), np.uint8)
    return PageSnapshot(status, image)


class Loop:
    """The daemon's side: hands over a snapshot when one is wanted, and counts them."""

    def __init__(self, page: StatusPage, shown: Callable[[int], PageSnapshot] = snapshot) -> None:
        self.handed_over = 0
        self._page, self._shown = page, shown
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while not self._stop.wait(0.002):
            if self._page.wanted:
                self.handed_over += 1
                self._page.show(self._shown(self.handed_over))

    def close(self) -> None:
        self._stop.set()
        self._thread.join()


@pytest.fixture
def page() -> Iterator[StatusPage]:
    with closing(StatusPage(PageConfig(port=0), MAP, answer_s=0.3)) as page:
        yield page


@pytest.fixture
def loop(page: StatusPage) -> Iterator[Loop]:
    with closing(Loop(page)) as loop:
        yield loop


def get(
    page: StatusPage, path: str, method: str = "GET", address: str = "127.0.0.1", **headers: str
) -> tuple[int, bytes, http.client.HTTPMessage]:
    connection = http.client.HTTPConnection("127.0.0.1", page.port, CUT_OFF_S, source_address=(address, 0))
    with closing(connection):
        connection.request(method, path, headers=headers)
        answer = connection.getresponse()
        return answer.status, answer.read(), answer.headers


def test_the_status_has_all_of_the_snapshot(page: StatusPage, loop: Loop) -> None:
    code, body, headers = get(page, "/status.json")
    status = json.loads(body)
    assert (code, headers["content-type"], headers["cache-control"]) == (200, "application/json", "no-store")
    assert (status["state"], status["newest"]["place"], status["camera"]["overwritten"]) == ("on the map", 7, 2)
    assert [one["used"]["stamp_ns"] for one in status["history"]] == [1000, 2000, 3000]


def test_history_is_sent_once(page: StatusPage, loop: Loop) -> None:
    assert [one["used"]["stamp_ns"] for one in json.loads(get(page, "/status.json?since=1000")[1])["history"]] == [
        2000,
        3000,
    ]
    assert get(page, "/status.json?since=yesterday")[0] == 400


def test_the_picture_comes_with_the_status_to_who_has_not_shown_it(page: StatusPage, loop: Loop) -> None:
    status = json.loads(get(page, "/status.json?shown=0")[1])
    picture: Any = cv2.imdecode(np.frombuffer(base64.b64decode(status["picture"]), np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape == (240, 320, 3)
    shown = 0
    while status["newest"]["stamp_ns"] != shown:  # another snapshot where the last is no longer fresh
        assert status["picture"]
        shown = status["newest"]["stamp_ns"]
        status = json.loads(get(page, f"/status.json?shown={shown}")[1])
    assert status["picture"] == ""
    assert json.loads(get(page, "/status.json")[1])["picture"] == ""
    assert get(page, "/status.json?shown=it")[0] == 400


def test_pictures(page: StatusPage, loop: Loop) -> None:
    code, body, headers = get(page, "/frame.jpg")
    picture: Any = cv2.imdecode(np.frombuffer(body, np.uint8), cv2.IMREAD_COLOR)
    assert (code, headers["content-type"], picture.shape) == (200, "image/jpeg", (240, 320, 3))
    assert np.abs(picture[180, 240].astype(int) - (10, 120, 240)).max() < 6
    assert get(page, "/thumbnail/3.jpg")[:2] == (200, THUMBNAIL)
    assert get(page, "/thumbnail/450.jpg")[0] == get(page, "/thumbnail/500.jpg")[0] == 404


def test_the_route_and_the_page_itself(page: StatusPage) -> None:
    assert json.loads(get(page, "/route.json")[1]) == {
        "places": 500,
        "starts": {"north": 0, "south": 300},
        "drives": [[[1.0, 2.0], [1.001, 2.0]], []],
        "own_camera": True,
    }
    code, body, headers = get(page, "/")
    assert code == 200
    assert b"<title>Lookback</title>" in body
    assert "default-src 'none'" in headers["content-security-policy"]
    assert b"http://" not in body.replace(b"http://www.w3.org", b"")  # nothing from elsewhere
    assert b"https://" not in body


def test_blueos_finds_a_service_and_opens_it_without_a_frame(page: StatusPage) -> None:
    service = json.loads(get(page, "/register_service")[1])
    assert (service["name"], service["avoid_iframes"]) == ("Lookback", True)
    assert {"description", "icon", "company", "version", "webpage", "api"} <= set(service)


def test_metrics_are_what_prometheus_reads(page: StatusPage, loop: Loop) -> None:
    families = {family.name: family for family in text_string_to_metric_families(get(page, "/metrics")[1].decode())}
    assert families["lookback_frames_used"].samples[0].value == 1
    frames = {sample.labels["outcome"]: sample.value for sample in families["lookback_camera_frames"].samples}
    assert frames == {"delivered": 10, "overwritten": 2, "bad": 1}
    states = {sample.labels["state"]: sample.value for sample in families["lookback_state"].samples}
    assert states["on the map"] == 1
    assert sum(states.values()) == 1
    assert families["lookback_stage_seconds"].samples[0].value == pytest.approx(0.0095)
    assert [(sample.labels, sample.value) for sample in families["lookback_place"].samples] == [({"map": "south"}, 7)]
    assert families["lookback_link_up"].samples[0].value == 0


MONITORING = Path(__file__).parents[3] / "docs/monitoring"


@pytest.mark.parametrize("file", ["alerts.yml", "dashboard.json"])
def test_alerts_and_dashboard_name_metrics_labels_and_states_that_exist(file: str) -> None:
    text = (MONITORING / file).read_text().replace('\\"', '"')
    link = LinkStatus("up", "serial:/dev/none:57600", "report", gps_doubt=0.1, gps_off_m=2.0, sent_ns=0)
    status = msgspec.structs.replace(snapshot(1).status, link=link)
    labels: dict[str, set[str]] = {}
    for family in text_string_to_metric_families(as_metrics(status).decode()):
        for sample in family.samples:
            labels.setdefault(sample.name, {"instance"}).update(sample.labels)
    named = set(re.findall(r"lookback_[a-z_]+", text))
    assert len(named) >= 8
    assert named <= set(labels), named - set(labels)
    for name, selector in re.findall(r"(lookback_[a-z_]+)\{([^}]*)\}", text):
        assert set(re.findall(r"(\w+)=", selector)) <= labels[name], (name, selector)
    for alternatives in re.findall(r'state=~?"([^"]+)"', text):
        assert set(alternatives.split("|")) <= set(STATES), alternatives


def test_metrics_say_what_has_left_and_by_what_the_vehicle_steers() -> None:
    link = LinkStatus(
        "up", "serial:/dev/none:57600", "auto", gps_use="lost", steers_by="dead reckoning", reckoned_m=140.0
    )
    link = dataclasses.replace(link, sent={"COMMAND_INT": 3, "VISION_POSITION_ESTIMATE": 40}, confirmed_ns=-int(2e9))
    text = as_metrics(msgspec.structs.replace(snapshot(1).status, stamp_ns=0, link=link, no_pose_m=42.0)).decode()
    assert 'lookback_gps_use{use="lost"} 1.0' in text and 'lookback_steering{by="dead reckoning"} 1.0' in text
    assert text.count("lookback_steering{") == 4 and "lookback_dead_reckoning_meters 140.0" in text
    assert "lookback_no_pose_meters 42.0" in text
    assert 'lookback_positions_sent_total{message="VISION_POSITION_ESTIMATE"} 40.0' in text
    assert "lookback_position_confirmed_age_seconds 2.0" in text and "position_age" not in text, "none has left since"


def test_doubt_and_verdict_of_gps_agree() -> None:
    """Doubt was 1, at which it is said, while nothing was said."""
    link = LinkStatus("up", "serial:/dev/none:57600", "report", gps_verdict="suspect", gps_doubt=1.0)
    said = {}
    for verdict in ("suspect", "faulty"):
        status = msgspec.structs.replace(snapshot(1).status, link=dataclasses.replace(link, gps_verdict=verdict))
        for family in text_string_to_metric_families(as_metrics(status).decode()):
            for sample in family.samples:
                said[verdict, sample.name] = sample.value
    assert (said["suspect", "lookback_gps_doubt"] < 1, said["suspect", "lookback_gps_faulty"]) == (True, 0)
    assert (said["faulty", "lookback_gps_doubt"], said["faulty", "lookback_gps_faulty"]) == (1, 1)


@pytest.mark.parametrize(("state", "ready"), [("on the map", 200), ("off the map", 200), ("degraded", 503)])
def test_a_probe_is_answered_live_and_ready(state: str, ready: int, page: StatusPage) -> None:
    def shown(number: int) -> PageSnapshot:
        one = snapshot(number)
        return dataclasses.replace(one, status=msgspec.structs.replace(one.status, state=state))

    with closing(Loop(page, shown)):
        code, body, _ = get(page, "/healthz")
        assert (code, json.loads(body)) == (200, {"live": True, "ready": ready == 200, "state": state})
        assert get(page, "/healthz/ready")[0] == ready


def test_nothing_is_made_until_somebody_looks_and_many_share_one(page: StatusPage, loop: Loop) -> None:
    get(page, "/")
    get(page, "/route.json")
    assert (page.wanted, loop.handed_over) == (False, 0)
    started_s = time.monotonic()
    frames = [json.loads(get(page, "/status.json")[1])["frames_used"] for _ in range(10)]
    fresh = 1 + int((time.monotonic() - started_s) / 0.2)
    assert loop.handed_over == frames[-1] <= fresh


def test_a_loop_that_hangs_is_said(page: StatusPage) -> None:
    for path in ("/status.json", "/healthz", "/healthz/ready"):
        assert get(page, path)[:2] == (503, b"the recognizer does not answer\n")
    assert get(page, "/")[0] == 200


@pytest.mark.parametrize("host", ["evil.example", "localhost.evil.example", "127.0.0.1.evil.example", "", "a:b:c", "@"])
def test_a_foreign_name_is_refused(page: StatusPage, host: str) -> None:
    """A web site that points its name at this computer (DNS rebinding) gets nothing."""
    assert get(page, "/", Host=host)[0] in (400, 421)


@pytest.mark.parametrize(
    "host", ["localhost", "LOCALHOST:8642", "127.0.0.1", "192.168.7.2:80", "[::1]:8642", "[fe80::1]"]
)
def test_addresses_and_localhost_are_served(page: StatusPage, host: str) -> None:
    assert get(page, "/", Host=host)[0] == 200


def test_a_name_in_the_config_is_served() -> None:
    with closing(StatusPage(PageConfig(port=0, hosts=("Rover.local",)), MAP)) as page:
        assert get(page, "/", Host="rover.local:8642")[0] == 200
        assert get(page, "/", Host="other.local")[0] == 421


@pytest.mark.parametrize(
    "path",
    [
        "/../../etc/passwd",
        "/%2e%2e/%2e%2e/etc/passwd",
        "/thumbnail/../page.py",
        "/thumbnail/-1.jpg",
        "/thumbnail/1e3.jpg",
        f"/thumbnail/{'4' * 4500}.jpg",
        "//",
        "/page.py",
    ],
)
def test_there_are_no_other_paths(page: StatusPage, path: str) -> None:
    assert get(page, path)[0] == 404


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH", "OPTIONS"])
def test_it_is_read_only(page: StatusPage, method: str) -> None:
    assert get(page, "/status.json", method)[0] == 405


def test_the_operator_says_where_the_vehicle_is(page: StatusPage) -> None:
    said, stop, path = list[tuple[float, ...]](), threading.Event(), "/here?lat_deg=-27.5&lon_deg=153&sigma_m=30"

    def use(*values: float) -> str:
        said.append(values)
        return "" if len(said) == 1 else "GPS is in use"

    def turn() -> None:
        while not stop.wait(0.002):
            page.answer_stated(use)

    assert get(page, path, "POST")[0] == 403, "a form of a foreign site has no such header"
    own = {"X-Lookback": "here"}
    assert get(page, path.replace("30", "wide"), "POST", **own)[0] == 400
    assert get(page, path, "POST", **own)[0] == 503, "nobody takes it"
    page.answer_stated(lambda *values: "")
    (thread := threading.Thread(target=turn)).start()
    answers = [get(page, path, "POST", **own)[:2] for _ in range(2)]
    stop.set()
    thread.join()
    assert answers == [(200, b"used\n"), (409, b"GPS is in use\n")]
    assert said == [(-27.5, 153.0, 30.0)] * 2


def raw(page: StatusPage, data: bytes, address: str = "127.0.0.1") -> socket.socket:
    connection = socket.create_connection(("127.0.0.1", page.port), CUT_OFF_S, source_address=(address, 0))
    connection.sendall(data)
    return connection


def test_two_host_headers_and_none_are_refused(page: StatusPage) -> None:
    for head in (b"Host: localhost\r\nHost: evil.example\r\n", b""):
        with closing(raw(page, b"GET / HTTP/1.1\r\n" + head + b"\r\n")) as connection:
            assert connection.recv(64).split()[1] in (b"400", b"421")


def test_a_head_without_end_is_cut_off(page: StatusPage) -> None:
    with closing(raw(page, b"GET / HTTP/1.1\r\nX: " + b"a" * 100_000)) as connection:
        answer = b""
        try:
            while piece := connection.recv(4096):
                answer += piece
        except ConnectionResetError:
            pass
        assert answer in (b"",) or answer.startswith(b"HTTP/1.1 4")


def open_files() -> int:
    """Of this process, which has both ends of each connection."""
    return len(list(Path("/proc/self/fd").iterdir()))


def ends(connection: socket.socket, trickles: bytes) -> bool:
    """Whether the page ends a connection though its client sends on a byte at a time."""
    give_up_s = time.monotonic() + CUT_OFF_S
    connection.settimeout(0.1)
    with contextlib.suppress(ConnectionResetError, BrokenPipeError):
        while time.monotonic() < give_up_s:
            with contextlib.suppress(TimeoutError):
                if not connection.recv(4096):
                    return True
            connection.sendall(trickles)
        return False
    return True


@pytest.fixture
def hasty() -> Iterator[StatusPage]:
    """A page with 400,000 points to show, that waits for a second where others wait for five."""
    view = dataclasses.replace(MAP, drives=(((1.23456789, 2.3456789),) * 400_000,))
    with closing(StatusPage(PageConfig(port=0), view, idle_s=1)) as page:
        yield page


@pytest.mark.parametrize(
    "sent",
    [
        b"",
        b"GET / HTTP/1.1\r\nHost: localhost\r\nX: ",
        b"POST / HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100000\r\n\r\n",
        b"GET /register_service HTTP/1.1\r\nHost: localhost\r\n\r\nGET / HTTP/1.1\r\nX: ",
    ],
    ids=["nothing", "a head", "a body", "a second head"],
)
def test_a_request_that_trickles_is_ended(hasty: StatusPage, sent: bytes) -> None:
    with closing(raw(hasty, sent)) as connection:
        assert ends(connection, b"a" if sent else b"")


def test_who_reads_no_answer_is_ended(hasty: StatusPage) -> None:
    with closing(raw(hasty, b"GET /route.json HTTP/1.1\r\nHost: localhost\r\n\r\n")) as connection:
        connection.recv(1)  # it has begun
        answering, give_up_s = open_files(), time.monotonic() + CUT_OFF_S
        while open_files() >= answering and time.monotonic() < give_up_s:
            select.select([], [], [], 0.1)
        assert open_files() < answering


def test_what_is_shown_to_a_page_that_has_stopped_is_dropped(page: StatusPage, loop: Loop) -> None:
    get(page, "/status.json")
    page.close()
    page.show(snapshot(1))


def test_a_restart_takes_the_same_port_at_once(page: StatusPage, loop: Loop) -> None:
    get(page, "/status.json")
    page.close()
    with closing(StatusPage(PageConfig(port=page.port), MAP)) as again:
        assert again.port == page.port
        assert get(again, "/")[0] == 200
