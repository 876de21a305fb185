"""The live page of a real `lookback run`, in headless Chromium, at the width of a phone and of a desk.

The daemon recognizes a real corridor in real time, with a simulated autopilot at its link, or with none.
"""

from __future__ import annotations

import contextlib
import dataclasses
import os
import re
import signal
import socket
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, get_args

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace

pytest.importorskip("starlette")
pytest.importorskip("selenium")

from selenium.webdriver.support.wait import WebDriverWait

from edge.config import DescriptorConfig, SamplingConfig
from edge.feed import FeedImages, FeedRow, read_feed
from edge.feed.writer import FeedWriter
from edge.journal.records import PlaceFix
from edge.keypoints.intrinsics import CameraDifference
from edge.localization.gps_monitor import GpsVerdictState
from edge.reference_map import Route
from edge.sequence import Correspondences
from edge.telemetry import LinkStatus
from edge_plugins.mapping.status import MappingStatus, MappingView
from edge_plugins.page import PageConfig
from edge_plugins.page.server import StatusPage
from edge_plugins.page.snapshot import PageSnapshot, beside_lane_m, map_view
from sim.maps.command import build_map
from tests.chromium import NEEDS_CHROMIUM, browser
from tests.common import PATIENCE_S
from tests.plugins.page.test_server import THUMBNAIL, Loop, snapshot
from tests.sim.coverage.roads import road, walk
from tests.udp_port import free_port

pytestmark = NEEDS_CHROMIUM
PICTURES = os.environ.get("LOOKBACK_PICTURES", "")
"""A folder for the screenshots, for people who want to look at them."""


@pytest.fixture(scope="module")
def config(shared: Path, play_on: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A config whose camera plays the corridor over and over, at 8 frames a second."""
    folder = tmp_path_factory.mktemp("page")
    corridor = read_feed(shared / "feeds/corridor_reference")
    build_map([corridor], folder / "corridor.map", DescriptorConfig(), SamplingConfig(by="frames"))
    query = read_feed(shared / "feeds/corridor_query")
    with FeedWriter(folder / "once", replace(query.header, video="", name="walk")) as writer:
        images = FeedImages(query)
        for number in range(len(query.rows)):
            writer.write(images.read(number), FeedRow("", number))
    play_on(folder / "once", folder / "walk", 125_000_000)
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    file = folder / "lookback.toml"
    file.write_text(
        '[camera]\nkind = "feed"\ndevice = "walk"\n[sampling]\nby = "frames"\n[map]\npath = "corridor.map"\n'
        "[sequence]\nlength = 10\n[acceptance]\nwindow_m = 10.0\n"
        f'[telemetry]\nconnection = "udpin:127.0.0.1:{free_port()}"\njournal = ""\n[page]\nport = {port}\n'
    )
    return file


def url_of(config: Path) -> str:
    return f"http://127.0.0.1:{config.read_text().rsplit('= ', 1)[1].strip()}/"


@contextlib.contextmanager
def daemon(config: Path) -> Iterator[subprocess.Popen[bytes]]:
    with subprocess.Popen([sys.executable, "-m", "edge", "run", str(config)], stderr=subprocess.PIPE) as process:
        try:
            wait = WebDriverWait[Any](None, PATIENCE_S, poll_frequency=0.05)
            wait.until(lambda _: is_up(url_of(config)))
            yield process
        finally:
            process.send_signal(signal.SIGTERM)
            process.communicate(timeout=60)


@contextlib.contextmanager
def autopilot(config: Path) -> Iterator[None]:
    link = re.findall(r"udpin:([\d.:]+)", config.read_text())[0]
    command = [sys.executable, "-m", "edge", "dev", "sim", "autopilot", "--udp", link, "--speed", "8"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            yield
        finally:
            process.terminate()  # not SIGINT, which a program that was started in the background ignores


def is_up(url: str) -> bool:
    with contextlib.suppress(urllib.error.URLError, ConnectionError):
        return bool(urllib.request.urlopen(url, timeout=60).status == 200)
    return False


def text(driver: Any, name: str) -> str:
    return str(driver.find_element("id", name).text)


def until(driver: Any, script: str) -> Any:
    return WebDriverWait(driver, PATIENCE_S, poll_frequency=0.1).until(lambda d: d.execute_script(f"return {script}"))


DRAWN = """[...document.querySelectorAll('canvas:not(#inliers)')].every((one) =>
    one.getContext('2d').getImageData(0, 0, one.width, one.height).data.some((value) => value))"""
PICTURES_SHOWN = "['frame', 'place'].every((id) => document.getElementById(id).naturalWidth > 50)"


def save_whole(driver: Any, width: int, name: str) -> None:
    whole = driver.execute_script("return document.documentElement.scrollHeight")
    metrics = {"width": width, "height": whole, "deviceScaleFactor": 1, "mobile": width < 600}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    until(driver, DRAWN)
    driver.save_screenshot(str(Path(PICTURES) / name))


def test_it_loads_draws_and_updates(config: Path) -> None:
    """On a phone at night, and on a screen by day."""
    with daemon(config), autopilot(config):
        for width, height, dark in ((390, 844, True), (1280, 900, False)):
            loads_draws_and_updates(config, width, height, dark=dark)


def loads_draws_and_updates(config: Path, width: int, height: int, *, dark: bool) -> None:
    with browser(width, height, dark=dark) as driver:
        driver.get(url_of(config))
        until(driver, "status !== null && newestMatch() !== null && newestMatch().accepted && past.length > 20")
        until(driver, PICTURES_SHOWN)
        assert not driver.find_element("id", "health").is_displayed()
        driver.execute_script("document.getElementById('details').open = true")
        assert until(driver, DRAWN)
        until(driver, f"status.frames_used > {driver.execute_script('return status.frames_used')}")
        until(
            driver, "status.state === 'on the map' && document.getElementById('answer').textContent.includes('place')"
        )
        until(
            driver,
            "['up, udpin:', 'running'].every((one) => document.getElementById('health').textContent.includes(one))",
        )
        assert driver.execute_script("return document.documentElement.scrollWidth") <= width
        background = driver.execute_script("return getComputedStyle(document.body).backgroundColor")
        assert (sum(map(int, background[4:-1].split(","))) < 200) == dark
        assert [line for line in driver.get_log("browser") if line["level"] == "SEVERE"] == []
        if PICTURES:
            save_whole(driver, width, f"page_{width}.png")


def test_it_survives_a_restart_and_says_what_is_wrong(config: Path) -> None:
    with browser(800, 600) as driver:
        with daemon(config):
            driver.get(url_of(config))
            until(driver, "status !== null && status.frames_used > 3")
            first = driver.execute_script("return status.started_unix_s")
            assert not driver.find_element("id", "silent").is_displayed()
        until(driver, "!document.getElementById('silent').hidden")
        assert driver.find_element("id", "silent").is_displayed()
        assert "stale" in driver.find_element("id", "main").get_attribute("class")
        until(driver, "document.getElementById('state').textContent === 'no answer'")
        with daemon(config):
            until(driver, f"document.getElementById('silent').hidden && status.started_unix_s > {first}")
            assert until(driver, "past.length > 0 && past.length <= status.frames_used")
            # There is no autopilot. The words change with each status.
            until(driver, "document.getElementById('answer').textContent.includes('link: no autopilot heard')")
            until(driver, "document.getElementById('state').className === 'warn'")


def test_a_lost_camera_is_said(config: Path, tmp_path: Path) -> None:
    lost = tmp_path / "lost.toml"
    port = url_of(config).rsplit(":", 1)[1].strip("/")
    lost.write_text(
        f'[camera]\ndevice = "/dev/no-such-camera"\n[map]\npath = "{config.parent / "corridor.map"}"\n'
        f'[telemetry]\nconnection = "serial:/dev/no-such-port:57600"\njournal = ""\n[page]\nport = {port}\n'
    )
    with daemon(lost), browser(390, 844) as driver:
        driver.get(url_of(config))
        until(driver, "document.getElementById('answer').textContent.includes('/dev/no-such-camera: No such file')")
        until(driver, "document.getElementById('state').className === 'bad'")
        assert text(driver, "frame-words") == "no frame yet"


def on_the_road(number: int) -> PageSnapshot:
    """A vehicle 200 m along a road that leads north, whose drive is mapped."""
    at = 200 / 110_574, 0.0
    link = LinkStatus("up", "udpin:127.0.0.1:1", "report", *at, heading_deg=0.0)
    mapping = MappingView(MappingStatus("mapping", "", "drive", 40, 20, 80.0), ((0.0018, 0.0), at), 1)
    shown = snapshot(number)
    status = shown.status
    newest = replace(status.newest, lat_deg=at[0], lon_deg=at[1], map=msgspec.UNSET) if status.newest else None
    history = tuple(replace(one, vehicle=at) for one in status.history)
    status = replace(status, link=link, mapping=mapping, newest=newest, history=history)
    return dataclasses.replace(shown, status=status)


def searching(gone_m: float, state: str) -> Callable[[int], PageSnapshot]:
    """A vehicle that has gone so far since a place was recognized."""

    def shown(number: int) -> PageSnapshot:
        before = on_the_road(number)
        history = tuple(
            replace(one, used=replace(one.used, accepted=not gone_m), searched=gone_m) for one in before.status.history
        )
        status = replace(before.status, state=state, searched=(gone_m, 80.0, "m"), history=history)
        return dataclasses.replace(before, status=status)

    return shown


def test_its_state_is_that_of_health_and_it_says_how_far_a_search_goes_and_what_helps(tmp_path: Path) -> None:
    """The pilot, the journal and /metrics have the same word. The map was made with a camera that looks back."""
    maps = road(tmp_path / "map", [(0.0, walk(150, np.random.default_rng(7)))])
    with browser(390, 844) as driver:
        for gone_m, state, view, goes_on, shade, is_late in (
            (50.0, "warming up", "front", "50 of about 80 m", "soft", False),
            (100.0, "off the map", "rear", "100 of about 80 m", "soft", False),
            (100.0, "off the map", "front", "100 of about 80 m", "soft", True),
            (130.0, "off the map", "front", "", "orange", True),
            (250.0, "off the map", "front", "", "orange", False),
            (0.0, "on the map", "front", "", "ink", False),
        ):
            with (
                contextlib.closing(StatusPage(PageConfig(port=0), map_view(maps, view))) as page,
                contextlib.closing(Loop(page, searching(gone_m, state))),
            ):
                driver.get(f"http://127.0.0.1:{page.port}/")
                until(driver, "status !== null")
                assert text(driver, "state") == state.upper()
                assert driver.find_element("id", "searched").is_displayed() == bool(goes_on)
                assert goes_on in text(driver, "answer") and ("of about" in text(driver, "answer")) == bool(goes_on)
                assert driver.execute_script(f"return shadeOf(past[0]) === color('{shade}')"), "of the trail"
                assert ("add a drive of this camera" in text(driver, "answer")) == is_late


def test_where_gps_is_lost_its_largest_word_is_that_no_position_comes(tmp_path: Path) -> None:
    """And each verdict on GPS has a color."""
    inexact, kinds = "recognized, but not exactly", {"consistent": "good", "faulty": "bad"}
    shown: list[PageSnapshot] = []

    def show(why: str, gps: str, sent_ns: int | None = None, emit: str = "auto", verdict: str = "cannot say") -> None:
        before = on_the_road(1)
        link = dataclasses.replace(before.status.link, gps=gps, emit=emit, gps_verdict=verdict)
        link = dataclasses.replace(link, sent_ns=sent_ns, sent_sigma_m=None if sent_ns is None else 4.0)
        shown[:] = [dataclasses.replace(before, status=replace(before.status, why=why, link=link))]

    show("", "not healthy")
    maps = road(tmp_path / "map", [(0.0, walk(150, np.random.default_rng(7)))])
    with (
        contextlib.closing(StatusPage(PageConfig(port=0), map_view(maps))) as page,
        contextlib.closing(Loop(page, lambda number: shown[0])),
        browser(390, 844) as driver,
    ):
        driver.get(f"http://127.0.0.1:{page.port}/")
        for given, headline, kind in (
            ((f"no position: {inexact}", "not healthy"), f"NO POSITION: {inexact}", "warn"),
            (("no position: no reset is needed, 1 m apart", "not healthy"), "ON THE MAP", "good"),
            (
                ("no position: the autopilot refuses positions", "unknown", 0),
                "NO POSITION: the autopilot refuses",
                "warn",
            ),
            (("", "not healthy", 0), "ON THE MAP, 4 m, 0 s ago", "good"),
            (("no position: GPS is healthy", "healthy"), "ON THE MAP", "good"),
            (("no position: emit is report", "not healthy", None, "report"), "ON THE MAP", "good"),
        ):
            show(*given)
            until(driver, f"document.getElementById('state').textContent.startsWith('{headline}')")
            assert driver.find_element("id", "state").get_attribute("class") == kind
            assert ("on the map" in text(driver, "answer")) == headline.startswith("NO POSITION")
        driver.execute_script("document.getElementById('details').open = true")
        for verdict in sorted({*get_args(GpsVerdictState)} - {"cannot say"}):
            show("", "healthy", verdict=verdict)
            cell = "[...document.querySelectorAll('#health dd')].find((one) => one.textContent.startsWith('%s'))"
            until(driver, cell % verdict)
            assert driver.execute_script(f"return ({cell % verdict}).className") == kinds.get(verdict, "warn")


AT = PlaceFix(4_000, 7, 200 / 110_574, 3.6e-06, 0.0, 0.6, 0.4, "forward", "same", 1.2)
"""A position 0.4 m to the right of a road that leads north."""


@pytest.mark.parametrize(("width", "height"), [(390, 844), (1400, 900)])
def test_in_large_it_says_whether_gps_is_lost_and_by_what_the_vehicle_steers(
    tmp_path: Path, width: int, height: int
) -> None:
    shown: list[PageSnapshot] = []

    def show(gps_use: str, steers_by: str, *, position: PlaceFix | None = None, **link: Any) -> None:
        before = on_the_road(1)
        changed = dataclasses.replace(before.status.link, emit="auto", gps_use=gps_use, steers_by=steers_by, **link)
        beside_m = None if position is None else beside_lane_m(position, Route(maps), 100)
        state = "off the map" if steers_by in ("dead reckoning", "unknown") else "on the map"
        status = replace(before.status, state=state, link=changed, position=position, beside_lane_m=beside_m)
        shown[:] = [dataclasses.replace(before, status=status)]

    maps = road(tmp_path / "map", [(0.0, walk(150, np.random.default_rng(7)))])
    show("in use", "GPS")
    with (
        contextlib.closing(StatusPage(PageConfig(port=0), map_view(maps))) as page,
        contextlib.closing(Loop(page, lambda number: shown[0])),
        browser(width, height) as driver,
    ):
        driver.get(f"http://127.0.0.1:{page.port}/")
        sent: dict[str, Any] = {"sent": {"VISION_POSITION_ESTIMATE": 412}, "sent_ns": 4_000, "sent_sigma_m": 0.7}
        for name, given, headline, kind, reach in (
            ("gps", ("in use", "GPS", {}), "GPS in use, steers by GPS", "good", "mapped for"),
            ("on_map", ("lost", "places", {"position": AT, **sent}), "GPS LOST, steers by places", "good",
             "position ± 0.7 m, 0 s ago · 0.4 m right of the mapped lane · mapped for 9"),
            ("off_map", ("lost", "dead reckoning", {"reckoned_m": 140.2}), "GPS LOST, steers by dead reckoning", "warn",
             "for 140 m"),
            ("unknown", ("lost", "unknown", {}), "GPS LOST, position unknown", "bad", None),
            ("faulty", ("faulty", "GPS", {"position": AT}), "GPS FAULTY, steers by GPS", "bad", "position ±"),
        ):  # fmt: skip
            show(*given[:2], **given[2])
            until(driver, f"document.getElementById('gps').textContent === '{headline}'")
            band = driver.find_element("id", "steering")
            assert band.get_attribute("class") == kind and (reach or "") in text(driver, "reach")
            assert reach is not None or not text(driver, "reach"), "nor what comes next"
            assert band.size["width"] >= 0.95 * width
            size = driver.execute_script("return parseFloat(getComputedStyle(document.getElementById('gps')).fontSize)")
            assert size >= 30, "readable at arm's length"
            if PICTURES:
                driver.save_screenshot(str(Path(PICTURES) / f"steering_{name}_{width}.png"))
        show("lost", "unknown")
        click(driver, "#fit")
        until(driver, "!document.getElementById('here-words').hidden")
        click(driver, "#route")
        driver.switch_to.alert.accept()
        stated = list[tuple[float, ...]]()

        def answered(_: Any) -> bool:
            page.answer_stated(lambda *at: stated.append(at) or "")  # type: ignore[func-returns-value]
            return bool(stated)

        WebDriverWait(driver, PATIENCE_S).until(answered)
        until(driver, "document.getElementById('here-words').textContent.endsWith('used.')")
        assert stated[0] == pytest.approx((150 / 110_574, 0.0, 30.0), abs=5e-4), "the middle of the map"
        driver.execute_script("document.getElementById('details').open = true")
        show("lost", "places", position=AT, **sent)
        until(
            driver,
            "document.getElementById('health').textContent.includes('412 poses, fused (VISION_POSITION_ESTIMATE)')",
        )
        show("in use", "GPS")
        until(driver, "document.getElementById('health').textContent.includes('no position yet')")
        assert "newest position sent" not in text(driver, "health")
        route = driver.find_element("id", "route").size
        blank = (
            "return document.querySelector('main section').clientHeight - document.getElementById('pair').clientHeight"
        )
        assert driver.execute_script(blank) < 120, "no card is half empty"
        assert driver.execute_script("return document.documentElement.scrollWidth") <= width
        assert route["width"] * route["height"] > 0.3 * width * height or width < 600, "the map fills a wide screen"


def test_points_that_agree_are_drawn_where_there_are_some(tmp_path: Path) -> None:
    on_map = road(tmp_path / "map", [(0.0, walk(150, np.random.default_rng(7)))])
    shares = np.random.default_rng(1).random((40, 4))
    found = CameraDifference(80.0, 88.26, 0.41, -0.021, 0.008, is_another=True)
    status = replace(on_the_road(1).status, camera_by_keypoints=found)
    verified = dataclasses.replace(on_the_road(1), correspondences=Correspondences(9, shares), status=status)
    drawn = "document.getElementById('inliers').getContext('2d').getImageData(0, 0, 500, 150).data.some((one) => one)"
    shown = [verified]
    maps = dataclasses.replace(map_view(on_map), thumbnail=lambda index: THUMBNAIL)
    with (
        contextlib.closing(StatusPage(PageConfig(port=0), maps)) as page,
        contextlib.closing(Loop(page, lambda number: shown[0])),
        browser(390, 844) as driver,
    ):
        driver.get(f"http://127.0.0.1:{page.port}/")
        until(driver, f"status !== null && status.inliers !== null && {drawn}")
        if PICTURES:
            driver.save_screenshot(str(Path(PICTURES) / "look.png"))
        assert text(driver, "matched") == "40 inliers"
        assert driver.find_element("id", "place").get_attribute("src").endswith("/thumbnail/9.jpg")
        driver.execute_script("document.getElementById('details').open = true")
        rows = "[...document.querySelectorAll('#health div')]"
        of_camera = f"{rows}.find((one) => one.textContent.startsWith('camera by'))"
        until(driver, f"{of_camera} !== undefined")
        cells = driver.execute_script(f"return [...({of_camera}).children].map((one) => one.textContent)")
        assert cells == ["camera by keypoints", "88.3 ± 0.4 degrees, k1 -0.02 ± 0.01; config 80.0 degrees"]
        assert driver.execute_script(f"return ({of_camera}).lastChild.className") == "warn"
        shown[0] = on_the_road(2)
        until(driver, f"status.inliers === null && !{drawn} && {of_camera} === undefined")


def click(driver: Any, name: str) -> None:
    (button,) = driver.find_elements("css selector", name)
    driver.execute_script("arguments[0].scrollIntoView({block: 'center'})", button)
    button.click()


def test_every_button_does_what_it_says(tmp_path: Path) -> None:
    maps = road(tmp_path / "map", [(0.0, walk(150, np.random.default_rng(7)))])
    with (
        contextlib.closing(StatusPage(PageConfig(port=0), map_view(maps))) as page,
        contextlib.closing(Loop(page, on_the_road)),
        browser(390, 844) as driver,
    ):
        driver.get(f"http://127.0.0.1:{page.port}/")
        until(driver, "status !== null")
        until(driver, "!document.getElementById('place').hasAttribute('src')")  # this map has no pictures
        near = driver.execute_script("return document.getElementById('route').toDataURL()")
        click(driver, "#fit")
        assert text(driver, "fit") == "track"
        assert driver.execute_script("return document.getElementById('route').toDataURL()") != near
        click(driver, "#fit")
        assert text(driver, "fit") == "whole map"

        click(driver, "#details summary")
        assert until(driver, DRAWN)
        assert driver.execute_script("return document.documentElement.scrollWidth") <= 390
        if PICTURES:
            save_whole(driver, 390, "buttons_390.png")
