"""`lookback demo`: the main task in simulation: take me home in one drive; then map, dusk, and home at night."""

from __future__ import annotations

import argparse
import io
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, contextmanager, redirect_stderr
from multiprocessing import get_context
from pathlib import Path

from tqdm import tqdm

from edge.config import Config, DescriptorConfig, MapConfig, PageConfig, RigConfig, SamplingConfig, TelemetryConfig
from edge.errors import ConfigError, LookbackError
from edge.extras import install_command
from edge.feed import read_feed
from edge.reference_map.store import ReferenceMap, open_map
from sim.calibration.command import measure_rig
from sim.calibration.offset import measure_parallax, rig_config
from sim.demo.review import Review, median_95, review_drive, stages_ms
from sim.maps.command import build_map
from sim.vehicle.daemon_drive import START_S, DaemonDrive, ReceivedFix, start_daemon_drive
from sim.world.recording import record_drive
from sim.world.scenario import Scenario

SEED = 7
LENGTH_M = 700.0
SPEED_MPS = 25.0  # brisk, to keep the demo short
MEASURED_M = 400.0  # of the route, for the rig's offset
WATCH_S = 0.1
PHOTOGRAPHED_AT = 6  # fixes of each drive
PAIRS = 3  # pictures of each drive in the report
SHARES = {"map": 25, "offset": 20, "take me home": 10, "live": 40, "report": 5}
"""Percent of the time that each stage takes on two cores; the story runs beside the first two."""
MARKER, POSITIONS = ".lookback-demo", "positions.txt"

MAP_DRIVE = Scenario(seed=SEED, length_m=LENGTH_M, view="rear", light="day", drive_seed=1)
DUSK = Scenario(seed=SEED, length_m=LENGTH_M, light="dusk", drive_seed=2, speed_mps=SPEED_MPS)
NIGHT = Scenario(seed=SEED, length_m=LENGTH_M, light="night", drive_seed=3, speed_mps=SPEED_MPS, direction="reverse")
WITH_GPS = (
    Scenario(seed=SEED, length_m=LENGTH_M, drive_seed=4),
    Scenario(seed=SEED, length_m=LENGTH_M, drive_seed=5, direction="reverse"),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of `lookback demo`."""
    parser.add_argument("-o", "--output", type=Path, default=Path("demo"), metavar="FOLDER")
    parser.add_argument(
        "--require-good", action="store_true", help="exit with 1 unless both drives gave correct fixes (CI)"
    )
    parser.add_argument("--pictures", type=Path, metavar="FOLDER", help="also write the README's images to this folder")
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    try:
        # Here and not above: matplotlib would take a third of a second of every command's start.
        from sim.demo.report import write_report
        from sim.demo.story import drive_story, headline, require_good
    except ModuleNotFoundError as error:
        package = str(error.name).partition(".")[0]
        raise ConfigError(f"demo: needs the package {package}: {install_command('sim')}") from None
    folder: Path = args.output
    started_s = time.monotonic()
    _make_folder(folder)
    bar = Bar()
    bar.say("1. Out by day with two cameras; GPS fails at the far end; home at night on the map made on the way")
    # On the other core, until the live drives need both.
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        driven = pool.submit(drive_story, folder / "take_me_home")
        bar.say("2. Meanwhile, out along another road by day, with the camera that looks back, to make a map")
        reference_map = _make_map(folder, bar)
        bar.say("3. Two short drives with GPS: how far ahead of the vehicle does the matched place lie?")
        rig = _measure_rig(folder, reference_map, bar)
        again_m, home_m = rig.ahead_forward_swapped_m, rig.ahead_reverse_same_m
        bar.say(f"   {again_m:.0f} m driving the same way, {home_m:.0f} m on the way home")
        story = driven.result()
    bar.advance("take me home")
    bar.say("4. Live, with the front camera, GPS failing soon: once more at dusk, and home at night (at the same time)")
    bar.say(f"   watch them: {_page_url(0)} and {_page_url(1)}")
    lives = _drive(folder, reference_map, rig, args.pictures, bar)
    reviews = [review_drive(live, PAIRS) for live in lives]
    for live, review in zip(lives, reviews, strict=True):
        bar.say(f"   {_in_short(live, review)}")
    report = write_report(folder / "report.html", reference_map, rig, lives, reviews, story)
    if args.pictures:
        from sim.demo.pictures import write_moving_picture

        write_moving_picture(args.pictures, story, folder / "take_me_home")
    bar.advance("report")
    bar.close()
    print(f"report: {report}   positions: {folder / POSITIONS}   ({time.monotonic() - started_s:.0f} s)")
    print(f"Home at night without GPS: {headline(story)}")
    if args.require_good:
        require_good(story)
    return 0 if not args.require_good or all(map(_is_good, lives, reviews)) else 1


class Bar:
    """One bar over all stages, on a terminal; the lines that are said meanwhile stand above it."""

    def __init__(self) -> None:
        form = "{percentage:3.0f}% |{bar}| {elapsed}"
        self._tqdm = tqdm(total=100.0, bar_format=form, disable=None, leave=False)
        self._done = 0.0

    def say(self, text: str) -> None:
        """Print a line."""
        self._tqdm.write(text)

    def advance(self, stage: str, share: float = 1.0) -> None:
        """This share of a stage is done."""
        self._done = min(100.0, self._done + SHARES[stage] * share)
        self._tqdm.update(self._done - self._tqdm.n)

    def over(self, stage: str, share: float) -> Callable[[list[float]], Iterator[float]]:
        """Passes items on, which together are this share of a stage."""

        def each(items: list[float]) -> Iterator[float]:
            for item in items:
                yield item
                self.advance(stage, share / len(items))

        return each

    def close(self) -> None:
        """Remove the bar."""
        self._tqdm.close()


def _make_folder(folder: Path) -> None:
    """An empty folder; one of an earlier demo is cleared, any other is kept."""
    if folder.exists() and any(folder.iterdir()) and not (folder / MARKER).exists():
        raise ConfigError(f"--output: {folder} has files that are not of a demo; name another folder")
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    (folder / MARKER).touch()


def _make_map(folder: Path, bar: Bar) -> ReferenceMap:
    record_drive(MAP_DRIVE, folder / "rear_day", progress=bar.over("map", 0.6))
    # Its own bar is not shown: tqdm draws none where nobody reads.
    with redirect_stderr(io.StringIO()):
        build_map([read_feed(folder / "rear_day")], folder / "rear_day.map", DescriptorConfig(), SamplingConfig())
    bar.advance("map", 0.4)
    return open_map(folder / "rear_day.map")


def _measure_rig(folder: Path, reference_map: ReferenceMap, bar: Bar) -> RigConfig:
    drives = []
    for scenario in WITH_GPS:
        path = folder / f"gps_{scenario.direction}"
        record_drive(scenario, path, up_to_m=MEASURED_M, progress=bar.over("offset", 0.25))
        drives.append(read_feed(path))
    offsets, seen = measure_rig(reference_map, drives)
    bar.advance("offset", 0.5)
    return rig_config(offsets, measure_parallax(seen))


def _drive(
    folder: Path, reference_map: ReferenceMap, rig: RigConfig, pictures: Path | None, bar: Bar
) -> list[DaemonDrive]:
    """Both drives at once, each with its own daemon and autopilot; positions are written down as they arrive."""
    port = PageConfig().port
    with ExitStack() as running:
        written = running.enter_context((folder / POSITIONS).open("w", encoding="utf-8"))
        lives = [
            running.enter_context(
                start_daemon_drive(name, scenario, folder / name, demo_settings(reference_map, rig, port + number))
            )
            for number, (name, scenario) in enumerate((("again_dusk", DUSK), ("home_night", NIGHT)))
        ]
        if pictures:
            running.enter_context(_photographer(lives[0], pictures))
        lasts_s = max(live.drive.duration_s for live in lives) + START_S
        begun_s = before_s = time.monotonic()
        while any(live.is_running for live in lives):
            time.sleep(WATCH_S)
            now_s = min(time.monotonic(), begun_s + lasts_s)
            bar.advance("live", (now_s - before_s) / lasts_s)
            before_s = now_s
            for live in lives:
                written.writelines(_spell(live, fix) for fix in live.new_fixes())
        for live in lives:
            live.wait_for_end()
    return lives


def demo_settings(reference_map: ReferenceMap, rig: RigConfig, page_port: int = 0) -> Config:
    """The daemon's settings for one of the drives; page_port: of its live page, 0 for none."""
    return Config(
        map=MapConfig(path=str(reference_map.path)),
        page=PageConfig(port=page_port),
        rig=rig,
        telemetry=TelemetryConfig(emit="external_position", journal_frames=True),
    )


PAGE_PX = (1280, 670)


def _page_url(number: int) -> str:
    return f"http://127.0.0.1:{PageConfig().port + number}/"


@contextmanager
def _photographer(live: DaemonDrive, pictures: Path) -> Iterator[None]:
    """Take a screenshot of the first drive's live page, once it is well under way."""
    from sim.demo.pictures import note_sources, photograph_page

    def photograph() -> None:
        while len(live.fixes) < PHOTOGRAPHED_AT and live.is_running:
            time.sleep(WATCH_S)
        picture = pictures / f"page_{live.name}.png"
        if photograph_page(_page_url(0), picture, *PAGE_PX):
            note_sources(pictures, picture.name)

    thread = threading.Thread(target=photograph, name="photographer")
    thread.start()
    yield
    thread.join()


def _spell(live: DaemonDrive, fix: ReceivedFix) -> str:
    return (
        f"{live.name:<10}  {fix.time_s:5.1f} s  at {fix.route_m:5.0f} m  position {fix.error_m:5.1f} m from the truth,"
        f" {fix.age_s * 1e3:3.0f} ms old; the autopilot was {fix.believed_error_m:4.1f} m off\n"
    )


def _in_short(live: DaemonDrive, review: Review) -> str:
    errors_m = [fix.error_m for fix in live.fixes]
    found = f"{len(errors_m)} positions, error (median / 95 %) {median_95(errors_m)}"
    if not errors_m:  # as on a computer that is too slow, or busy
        found = f"no position; a frame took {sum(stages_ms(live).values()):.0f} ms"
    return f"{live.name:<10}  {found}; precision {review.precision:.3f}, recall {review.recall:.2f}"


def _is_good(live: DaemonDrive, review: Review) -> bool:
    """Whether fixes arrived and nearly all are right: the criterion of the smoke test."""
    if len(live.fixes) < 5 or not review.precision >= 0.9:
        raise LookbackError(f"{live.name}: {len(live.fixes)} fixes, precision {review.precision:.3f}: not good enough")
    return True
