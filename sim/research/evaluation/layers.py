"""What `lookback map learn` makes of eight drives over one road, by descriptors of simulated worlds.

    python -m sim.research.evaluation.layers --seeds 701 702 --cache FOLDER

Eight drives, two of a rear camera (day, dusk) and six of a front camera (day, night, dusk, rain, snow, day), become a
folder of maps. A front camera drives over it the same way by dusk, and home by night. Each row is a folder: its places
searched, the first right belief, recall and precision on both. After learning without counts, two drives each way are
counted, as the daemon does, and the folder learns again. Descriptors are kept in FOLDER.

With --rebuilt, a tenth of the road looks like that of the other seed from some day on. A folder of four drives from
before gets a drive from after, and learns, again and again; each row is the recall on that tenth, by dusk.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from edge.config import Config, RigConfig, SamplingConfig
from edge.descriptor.network import Network
from edge.layers import DriveTally
from edge.reference_map import LearnedFolder, ModelKey, open_map_set
from edge.reference_map.builder import MapBuilder, Place
from edge.reference_map.store import RegionsKey
from edge.sequence import Direction, Travel
from edge.sequence_matcher import SequenceMatcher
from sim.maps.learning import learn
from sim.research.evaluation.belief import FIRST_FRAME, TOLERANCE_M, Described, described
from sim.world.scenario import LightName, Scenario, View

DRIVES: tuple[tuple[View, LightName, int], ...] = (
    ("rear", "day", 1),
    ("rear", "dusk", 2),
    ("front", "day", 11),
    ("front", "night", 12),
    ("front", "dusk", 13),
    ("front", "rain", 14),
    ("front", "snow", 15),
    ("front", "day", 16),
)
OLD: tuple[tuple[View, LightName, int], ...] = (
    ("rear", "day", 1),
    ("front", "day", 11),
    ("front", "night", 12),
    ("front", "rain", 14),
)
NEW: tuple[tuple[View, LightName, int], ...] = (("front", "snow", 15), ("front", "day", 16), ("front", "dusk", 13))
REBUILT = slice(180, 220)
GRAY: dict[LightName, int] = {"day": 120, "dusk": 60, "night": 20, "rain": 100, "snow": 140}
M_PER_DEG = 110_574.0
FIRST_COURSE = 12
"""The first frame with a course, as of `TurnAround`."""
AHEAD_M = 30.0
"""That a front camera sees before a rear one that looks the other way: the median of docs/evaluation.md."""


def write_drive(path: Path, drive: Described, view: View) -> None:
    """A map of one drive, straight north along its route."""
    model, sampling = ModelKey("cached", "0" * 64, "fc6", drive.raw.shape[2]), SamplingConfig()
    with MapBuilder(path, model, RegionsKey("left-right", 0.4, "set"), sampling) as builder:
        builder.begin_segment(path.name, view)
        for row, route_m in enumerate(drive.route_m.tolist()):
            place = Place(row, route_m / M_PER_DEG, 8.0, 400.0, 0.0, route_m, b"", 1.5, "gps")
            builder.add(drive.raw[row].astype(np.float32), place)
        builder.finish()


def drive_over(
    folder: Path,
    query: Described,
    light: LightName,
    tally: DriveTally,
    judged: slice = slice(FIRST_FRAME, None),
    knows_course: bool = True,
) -> list[float]:
    """Meters to the first right belief, recall, precision, and places searched, of one drive of a front camera.

    judged: frames that count for recall and precision.
    """
    maps = open_map_set(folder)
    matcher = SequenceMatcher(maps, Config(rig=RigConfig(parallax=1.0)))
    course_rad = (0.0 if query.route_m[-1] > query.route_m[0] else np.pi) if knows_course else None
    image = np.full((16, 16, 3), GRAY[light], np.uint8)
    right, believed, first_m = [], [], float("inf")
    for frame, (raw, driven_m) in enumerate(zip(query.raw.astype(np.float32), query.driven_m.tolist(), strict=True)):
        match = matcher.push(raw, Travel(driven_m, course_rad=course_rad if frame >= FIRST_COURSE else None))
        is_believed = match is not None and match.accepted
        off_m = float("inf")
        if match is not None:
            faces = maps.index.view(maps.index.segment_of(match.place_index)) == "rear" and match.direction == "forward"
            off_m = maps.places["route_m"][match.place_index] - query.route_m[frame] - AHEAD_M * faces
            if is_believed:
                tally.count(maps, match.place_index, match.direction, image, driven_m, 0)
        is_right = is_believed and abs(off_m) <= TOLERANCE_M
        first_m = min(first_m, driven_m - query.driven_m[0]) if is_right else first_m
        right.append(is_right)
        believed.append(is_believed)
    precision = sum(right[judged]) / max(1, sum(believed[judged]))
    return [first_m, float(np.mean(right[judged])), precision, float(maps.index.places)]


def folder_of(folder: Path, drives: Sequence[tuple[View, LightName, Described]]) -> Path:
    """A folder of maps of these drives."""
    for number, (view, light, drive) in enumerate(drives):
        write_drive(folder / f"{number}-{view}-{light}", drive, view)
    return folder


def rebuild(drive: Described, other: Described) -> Described:
    """A drive over a road of which a tenth looks like another one."""
    raw = drive.raw.copy()
    raw[REBUILT] = other.raw[REBUILT]
    return replace(drive, raw=raw)


def main_rebuilt(seeds: Sequence[int], scene: Callable[..., Described]) -> None:
    """Print a row for each drive since the road was rebuilt."""
    print("| seed | drives since then | places | recall on the rebuilt tenth |\n|---|---|---|---|")
    for seed, other in zip(seeds, [*seeds[1:], seeds[0]], strict=True):

        def after(view: View, light: LightName, drive: int, seed: int = seed, other: int = other) -> Described:
            of_both = (scene(one, view, light, drive) for one in (seed, other))
            return rebuild(*of_both)

        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary)
            for view, light, drive in OLD:
                write_drive(folder / f"old-{view}-{light}", scene(seed, view, light, drive), view)
            for number, (_, light, drive) in enumerate((("", "dusk", 0), *NEW)):
                if number:
                    write_drive(folder / f"new-{number}", after("front", light, drive), "front")
                    learn(folder).keep(LearnedFolder(folder))
                for run in range(2):
                    tally = DriveTally(folder, "front", time.time(), f"{number}-{run}")
                    results = drive_over(folder, after("front", "dusk", 21), "dusk", tally, REBUILT)
                    tally.close()
                print(f"| {seed} | {number} | {results[3]:.0f} | {results[1]:.2f} |", flush=True)


def main() -> None:
    """Print a row for each folder and seed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", required=True)
    parser.add_argument("--cache", type=Path, required=True)
    parser.add_argument("--length", type=float, default=800.0, help="of the road, m")
    parser.add_argument("--no-course", action="store_true", help="nothing knows which way the vehicle goes")
    parser.add_argument("--rebuilt", action="store_true", help="the road that was rebuilt instead")
    args = parser.parse_args()
    args.cache.mkdir(parents=True, exist_ok=True)
    network = Network.load()

    def scene(seed: int, view: View, light: LightName, drive: int, way: Direction = "forward") -> Described:
        scenario = Scenario(seed=seed, length_m=args.length, view=view, light=light, direction=way, drive_seed=drive)
        return described(scenario, network, args.cache)

    if args.rebuilt:
        main_rebuilt(args.seeds, scene)
        return
    print("| seed | folder | places | dusk, same way: first, recall, precision | home at night: the same |")
    print("|---|---|---|---|---|")
    for seed in args.seeds:
        made = [(view, light, scene(seed, view, light, drive)) for view, light, drive in DRIVES]
        dusk, home = scene(seed, "front", "dusk", 21), scene(seed, "front", "night", 22, "reverse")

        def row(what: str, folder: Path, seed: int = seed, dusk: Described = dusk, home: Described = home) -> None:
            cells = []
            for query, light in ((dusk, "dusk"), (home, "night")):
                tally = DriveTally(folder, "front", time.time(), f"{light}-{what}")
                found = drive_over(folder, query, light, tally, knows_course=not args.no_course)  # type: ignore[arg-type]
                first_m, recall, precision, places = found
                tally.close()
                cells.append(f"{first_m:.0f} m, {recall:.2f}, {precision:.3f}")
            print(f"| {seed} | {what} | {places:.0f} | {cells[0]} | {cells[1]} |", flush=True)

        with tempfile.TemporaryDirectory() as temporary:
            row("first rear drive", folder_of(Path(temporary) / "one", made[:1]))
            folder = folder_of(Path(temporary) / "all", made)
            row("all eight", folder)
            for what in ("learned", "learned again"):
                learned = learn(folder)
                learned.keep(LearnedFolder(folder))
                names = {number: drive.path.name for number, drive in enumerate(learned.drives)}
                for number, why in {**learned.choice.searched, **learned.choice.retired}.items():
                    print(f"    {names[number]:16} {number in learned.choice.searched!s:6} {why}")
                row(what, folder)


if __name__ == "__main__":
    main()
