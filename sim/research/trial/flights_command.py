"""`lookback dev flights`: what the daemon of today does on recorded drives, beside what was recorded."""

from __future__ import annotations

import argparse
import csv
import logging
import math
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import msgspec
import numpy as np

from edge import __version__
from edge.descriptor.network import Network
from edge.errors import ConfigError, FeedError, LookbackError, SetupError
from edge.journal.records import FixSent, FrameUsed
from sim.journal import records_of
from sim.research.trial.flight_score import MOVES_M, Score, autopilot_errors, dead_reckoning_errors, lane_errors, score
from sim.research.trial.listed_drive import ListedDrive
from sim.research.trial.recorded_drive import LINK, WE, RecordedDrive, read_drive, read_scenarios
from sim.research.trial.replayed_drive import replay
from sim.research.trial.table import as_row, markdown, put_between, side_by_side, spread
from sim.trial.records import Array
from sim.trial.run import JOURNAL
from sim.trial.views import RoadLibrary

OF_POSITIONS = (
    *("positions", "error, median / 95 % / largest", "over sigma, rms / largest", "beyond 3, 4"),
    "levels, exceeded along-track, cross-track",
)
COLUMNS = (
    *("drive", *OF_POSITIONS, "first after", "longest silence", "frames used, accepted, false"),
    *("dead reckoning's error", "autopilot's error", "beside its lane"),
)
KINDS_COLUMNS = "drives", *OF_POSITIONS, "dead reckoning's error, median of the drives"
RESETS = "nearer_by_poses", "further_by_poses", "nearer_by_sequences", "further_by_sequences"
RECORDED_M = ("reckoned_m", "autopilot_m", "lane_m")
SECTION = "flights"
WORSE_M = 0.5
"""By so much the median error of positions may be above that of none before the drive counts as made worse."""


class Flight(msgspec.Struct, frozen=True):
    """A drive as it was recorded, and as the daemon of today does; recorded: of the autopilot and of the vehicle.

    kind: its firmware and its light. reckoned_m: of the autopilot without positions, see `dead_reckoning_errors`.
    lost_m: driven since GPS was lost.
    """

    name: str
    kind: str
    then: Score
    now: Score
    reckoned_m: list[float]
    autopilot_m: list[float]
    lane_m: list[float]
    lost_m: float


class ReplayFailure(msgspec.Struct, frozen=True):
    """A drive that cannot be replayed, and why not."""

    name: str
    why: str


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of `lookback dev flights`."""
    about = (
        "recorded drives, a folder of them, or what `lookback bundle` made: of it, the list of the drive is replayed"
    )
    parser.add_argument("flights", nargs="+", type=Path, metavar="FOLDER", help=about)
    parser.add_argument(
        "--jobs", type=int, default=1, metavar="N", help="maps whose drives run side by side (default 1)"
    )
    output = "for the table, flights.json with every position, and journals (default flights)"
    parser.add_argument("-o", "--output", type=Path, default=Path("flights"), metavar="FOLDER", help=output)
    views = "keeps what was rendered for the next time, 110 MB for each drive (default: views/ in the output)"
    parser.add_argument("--views", type=Path, metavar="FOLDER", help=views)
    parser.add_argument("--model", type=Path, help="the network of the maps and the daemon (default fc6, as recorded)")
    keypoints = "give the maps keypoints, where they were not made on the way"
    parser.add_argument("--keypoints", action="store_true", help=keypoints)
    about = "a page of docs, to write what each kind of drive has into, and beside it a CSV file with all drives"
    parser.add_argument("--page", type=Path, metavar="FILE", help=about)
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    if args.jobs < 1:
        raise ConfigError("--jobs: at least 1")
    bundles = [given for given in args.flights if given.is_file()]
    folders = [given for given in args.flights if given not in bundles]
    folders = [path for given in folders for path in ([given] if (given / LINK).exists() else _inside(given))]
    if not folders and not bundles:
        raise FeedError(f"{args.flights[0]}: no recorded drive in it; one has {LINK}")
    args.output.mkdir(parents=True, exist_ok=True)
    listed, views = [_listed(bundle) for bundle in bundles], args.views or args.output / "views"
    flights = replay_all(folders, args.output, views, args.jobs, args.model, listed, keypoints=args.keypoints)
    options = [*([f"--model {args.model}"] if args.model else []), *["--keypoints"] * args.keypoints]
    given = " ".join([*(path.name for path in args.flights), *options])
    publish(flights, given, args.page)
    print(table(flights))
    return 0


def _listed(bundle: Path) -> Flight:
    """A drive from the field, of which neither autopilot nor pictures are replayed."""
    drive = ListedDrive(bundle)
    return Flight(bundle.stem, "from the field", drive.then, drive.now, [], [], [], round(drive.lost_m, 1))


def publish(flights: Sequence[Flight | ReplayFailure], given: str, page: Path | None) -> None:
    """Write the table of kinds, and what all drives say together, into a page, with a CSV of all drives beside it.

    given: the arguments of the command.
    """
    if page is not None:
        made = f"`lookback dev flights {given}` of version {__version__}:"
        put_between(SECTION, page, f"{made}\n\n{kinds_table(flights)}")
        with page.with_suffix(".csv").open("w", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerows(cells(flights))


def cells(flights: Sequence[Flight | ReplayFailure]) -> Iterator[list[object]]:
    """Every figure of every drive, two rows each, below one of their names."""
    names = [f"{name}_{share}" for name in RECORDED_M for share in ("median", "p95", "max")]
    keys = list(Score([], 0.0, 0, 0, 0, []).row())
    yield ["drive", "kind", "when", *keys, *names]
    for flight in flights:
        if isinstance(flight, ReplayFailure):
            yield [flight.name, f"not replayed: {flight.why}"]
            continue
        recorded = [one for name in RECORDED_M for one in getattr(flight, name) or [""] * 3]
        for when, found in (("then", flight.then), ("now", flight.now)):
            figures = ["" if math.isnan(one) else f"{one:.3f}".rstrip("0").rstrip(".") for one in found.row().values()]
            yield [flight.name, flight.kind, when, *figures, *recorded]


def kinds_table(flights: Sequence[Flight | ReplayFailure]) -> str:
    """The positions of today of all drives of a firmware in a light together; and what all drives say together."""
    kinds: dict[str, list[Flight]] = {}
    for flight in flights:
        if isinstance(flight, Flight):
            kinds.setdefault(flight.kind, []).append(flight)
    lines = []
    for kind, drives in sorted(kinds.items()):
        reckoned_m = [one.reckoned_m[0] for one in drives if one.reckoned_m]
        alone = f"{np.median(reckoned_m):.1f} m" if reckoned_m else ""
        lines.append([f"{len(drives)} {kind}", *_cells(_pooled([one.now for one in drives]))[:5], alone])
    return f"{markdown(KINDS_COLUMNS, lines)}\n\n{summary(flights, ('now',))}"


def _pooled(scores: Sequence[Score]) -> Score:
    return Score([position for one in scores for position in one.positions], 0.0, 0, 0, 0, [])


def _inside(folder: Path) -> list[Path]:
    return sorted(path.parent for path in folder.glob(f"*/{LINK}"))


def replay_all(
    folders: Sequence[Path],
    output: Path,
    views: Path,
    jobs: int,
    model: Path | None = None,
    listed: Sequence[Flight] = (),
    *,
    keypoints: bool = False,
) -> list[Flight | ReplayFailure]:
    """Replay drives, those on one road one after the other. model: as `resolve_model` has it. listed: done already.

    flights.json and flights.md in `output` have what is done as soon as a road is.
    """
    by_road: dict[int | None, list[Path]] = {}
    for folder in folders:
        by_road.setdefault(_road(folder), []).append(folder)
    groups = sorted(by_road.values(), key=len, reverse=True)
    found: dict[Path, Flight | ReplayFailure] = {}
    flights: list[Flight | ReplayFailure] = [*listed]
    _write(flights, output)
    replayed = partial(replay_group, output=output, views=views, model=model, keypoints=keypoints)
    for group in side_by_side(replayed, groups, jobs):
        found.update(group)
        flights = [*listed, *(found[folder] for folder in folders if folder in found)]
        _write(flights, output)
    return flights


def _write(flights: Sequence[Flight | ReplayFailure], output: Path) -> None:
    (output / "flights.json").write_bytes(msgspec.json.format(msgspec.json.encode(flights), indent=1))
    (output / "flights.md").write_text(page(flights), encoding="utf-8")


def _road(folder: Path) -> int | None:
    try:
        return read_scenarios(folder)[-1][1].seed
    except (SetupError, OSError, ValueError, LookupError):  # which is said with its row
        return None


def replay_group(
    folders: Sequence[Path], output: Path, views: Path, model: Path | None = None, *, keypoints: bool = False
) -> list[tuple[Path, Flight | ReplayFailure]]:
    """Replay drives on one road, in one process; each prints its rows."""
    logging.getLogger("edge").setLevel(logging.ERROR)
    library, drives = RoadLibrary(Network.load(model), views), {}
    found: list[tuple[Path, Flight | ReplayFailure]] = []

    def add(folder: Path, flight: Flight | ReplayFailure) -> None:
        found.append((folder, flight))
        print("\n".join(map(as_row, rows(flight))), flush=True)

    try:
        for folder in folders:
            try:
                drives[folder] = read_drive(folder)
            except SetupError as error:
                add(folder, ReplayFailure(folder.name, str(error)))
        for folder, drive in drives.items():
            matched = [frame for one in drives.values() if one.map_name == drive.map_name for frame in one.used]
            try:
                add(folder, _replay(drive, matched, output / drive.name, library, keypoints=keypoints))
            except (LookbackError, RuntimeError) as error:  # of a plug-in that failed
                add(folder, ReplayFailure(folder.name, str(error)))
            library.save()
    finally:
        library.close()
    return found


def _replay(
    drive: RecordedDrive, matched: list[FrameUsed], folder: Path, library: RoadLibrary, *, keypoints: bool
) -> Flight:
    then = [(one.time_s, one.message) for one in drive.link if one.message.get_srcComponent() == WE]
    sent = replay(drive, matched, folder, library, keypoints=keypoints)
    journal = folder / JOURNAL
    return Flight(
        drive.name,
        f"{'ArduPilot' if drive.name.startswith('ardupilot') else 'PX4'}, {drive.scenario.light}",
        score(drive, then, drive.sent, drive.used),
        score(
            drive,
            sent,
            list(records_of(journal, FixSent)),
            list(records_of(journal, FrameUsed)),
        ),
        _three(dead_reckoning_errors(drive)),
        _three(autopilot_errors(drive)),
        _three(lane_errors(drive)),
        round(drive.lost_m, 1),
    )


def _three(errors_m: Array) -> list[float]:
    return [round(float(one), 2) for one in np.percentile(errors_m, [50, 95, 100])] if len(errors_m) else []


def rows(flight: Flight | ReplayFailure) -> list[list[str]]:
    """Two rows of the table: as recorded, and now, which does not move the recorded autopilot."""
    if isinstance(flight, ReplayFailure):
        return [[flight.name, f"not replayed: {flight.why}"]]
    recorded = [spread(errors_m) for errors_m in (flight.reckoned_m, flight.autopilot_m, flight.lane_m)]
    then, now = _cells(flight.then), _cells(flight.now)
    return [[f"{flight.name}, then", *then, *recorded], ["now", *now, "", "", ""]]


def _cells(found: Score) -> list[str]:
    one = found.row()
    cells = [
        "{sent}",
        spread([one[key] for key in ("median_m", "p95_m", "max_m")]),
        "{sigmas_rms:.2f} / {sigmas_max:.1f}",
        "{beyond_3}, {beyond_4}",
        "{levels}, {over_along}, {over_cross_track}",
        "{first_m:.0f} m",
    ]
    cells = cells if one["sent"] else ["0", *["-"] * 5]
    return [cell.format(**one) for cell in (*cells, "{silent_s:.0f} s", "{used}, {believed}, {false}")]


def table(flights: Sequence[Flight | ReplayFailure]) -> str:
    """All drives, and what they say together."""
    return f"{markdown(COLUMNS, [row for one in flights for row in rows(one)])}\n\n{summary(flights)}"


def summary(flights: Sequence[Flight | ReplayFailure], times: Sequence[str] = ("then", "now")) -> str:
    """What all drives say together, at some of both times."""
    replayed = [one for one in flights if isinstance(one, Flight)]
    together = [f"- {when}: {_together([getattr(one, when) for one in replayed])}" for when in times]
    together += [_made_worse(replayed)]
    lost_km = sum(one.lost_m for one in replayed) / 1000
    return "\n".join([f"All {len(replayed)} drives together, {lost_km:.1f} km since GPS was lost:\n", *together])


def _made_worse(flights: Sequence[Flight]) -> str:
    """The drives whose positions of today are worse than none."""
    known = [one for one in flights if one.reckoned_m and one.now.positions]
    worse_m = {one.name: float(one.now.row()["median_m"]) - one.reckoned_m[0] for one in known}
    names = ", ".join(f"{name} ({by_m:.1f} m)" for name, by_m in worse_m.items() if by_m > WORSE_M)
    return f"- median error over {WORSE_M} m above that of dead reckoning: {names or 'none'} of {len(known)} drives"


def _together(scores: Sequence[Score]) -> str:
    found = [one.row() for one in scores]
    sums = {key: sum(one[key] for one in found) for key in ("sent", "fused", "known", "beyond_3", "beyond_4", "levels")}
    over = sum(one["over_along"] for one in found), sum(one["over_cross_track"] for one in found)
    resets = [sum(one[key] for one in found) for key in RESETS]
    return (
        "{sent} positions, {fused} of them poses that are fused; of {known} whose standard deviation the journal has,"
        " {beyond_3} beyond three and {beyond_4} beyond four of them; of {levels} with finite levels, {} beyond that"
        f" along-track and {{}} cross-track; resets by {MOVES_M:.0f} m or more: by keypoint poses {{}} brought the"
        " autopilot nearer to the truth, {} did not; by sequence matches {}, {} did not"
    ).format(*over, *resets, **sums)


def page(flights: Sequence[Flight | ReplayFailure]) -> str:
    """The table, and what the pilot read then and now."""
    texts = [
        f"\n## {flight.name}\n\n"
        + "\n".join(
            f"{when}:\n\n" + "\n".join(f"    {one.time_s:8.1f} s  {one.text}" for one in found.texts) + "\n"
            for when, found in (("then", flight.then), ("now", flight.now))
        )
        for flight in flights
        if isinstance(flight, Flight)
    ]
    return "\n".join([table(flights), *texts]) + "\n"
