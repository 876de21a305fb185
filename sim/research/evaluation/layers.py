"""What `lookback map learn` makes of eight drives over one road, by descriptors of simulated worlds.

    python -m sim.research.evaluation.layers --seeds 811 812 813 --cache FOLDER --page docs/living-maps.md

Eight drives, two of a rear camera (day, dusk) and six of a front camera (day, night, dusk, rain, snow, day), become a
folder of maps. Descriptors are kept in FOLDER. Tables:

learned   A front camera drives over the folder the same way by dusk, and home by night; before and after learning
rebuilt   a tenth of the road looks like that of the next seed from some day on: recall there, by dusk
shifted   one drive is recorded 15 m aside, or from half of the road on: what `map learn` says, and who moves
hundred   as many drives: what is searched, how long learning takes
frames    of the recognizer while learning runs, and without

--picture FILE draws the layers of a road of which 200 m were rebuilt.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from edge.config import Config, RigConfig, SamplingConfig
from edge.descriptor.network import Network
from edge.geodesy import east_north, moved
from edge.reference_map import ModelKey, open_map_set
from edge.reference_map.learned import LearnedFolder
from edge.reference_map.store import RegionsKey
from edge.sequence import Direction, Travel
from edge.sequence_matcher import SequenceMatcher
from edge_plugins.layers.tally import DriveTally
from edge_plugins.mapping.builder import NAN, MapBuilder, Place, thumbnail
from sim.maps.learning import Lesson, learn
from sim.maps.picture import write_layers
from sim.research.evaluation.learning_frames import frames_rows
from sim.research.evaluation.roads import FIRST_FRAME, TOLERANCE_M, Described, described
from sim.research.evaluation.tables import options, publish
from sim.research.pictures import note_sources
from sim.research.trial.courses.maps import DRIVES
from sim.trial.receiver_errors import receiver_errors
from sim.world.route import Route as Road
from sim.world.scenario import LightName, Scenario, View

Floats: TypeAlias = NDArray[np.float64]
Scene: TypeAlias = Callable[..., Described]
"""Seed of the road, view, light, seed of the drive, and direction, to its descriptors."""

OLD: tuple[tuple[View, LightName, int], ...] = (
    ("rear", "day", 1),
    ("front", "day", 11),
    ("front", "night", 12),
    ("front", "rain", 14),
)
NEW: tuple[tuple[View, LightName, int], ...] = (("front", "snow", 15), ("front", "day", 16), ("front", "dusk", 13))
REBUILT = slice(180, 220)
GRAY: dict[LightName, int] = {"day": 120, "dusk": 60, "night": 20, "rain": 100, "snow": 140}
ORIGIN, SIGMA_M, LANE_M = (0.0, 8.0), 1.5, 1.75
ASIDE_M, SHIFTED = 15.0, (1, 2, 3, 6)
"""How far which drives are off, of DRIVES: one of two rear ones, by day, by night, and in snow."""
PICTURED = slice(150, 250)
"""Places that look otherwise in the picture: two stretches that are counted."""
HUNDRED = 100
FIRST_COURSE = 12
"""The first frame with a course, as of `TurnAround`."""
AHEAD_M = 30.0
"""That a front camera sees before a rear one that looks the other way: the median of docs/evaluation.md."""


def write_drive(
    path: Path,
    drive: Described,
    view: View,
    off_m: Floats | None = None,
    light: LightName = "day",
    road: Road | None = None,
) -> None:
    """A map of one drive, straight north along its route, unless along a road.

    off_m: (N, 2) east and north, by how much its positions are wrong. light: of its pictures.
    """
    picture = thumbnail(np.full((24, 32, 3), GRAY[light], np.uint8))
    at_m = _true(drive)
    if road is not None:
        at_m = np.array([road.at(route_m, LANE_M)[:2] for route_m in drive.route_m.tolist()])
    at_m = at_m if off_m is None else at_m + off_m
    model, sampling = ModelKey("cached", "0" * 64, "fc6", drive.raw.shape[2]), SamplingConfig()
    with MapBuilder(path, model, RegionsKey("left-right", 0.4, "set"), sampling) as builder:
        builder.begin_segment(path.name, view)
        for row, route_m in enumerate(drive.route_m.tolist()):
            lat_deg, lon_deg = moved(*ORIGIN, *at_m[row])
            heading_deg = NAN if road is not None else 0.0
            place = Place(row, lat_deg, lon_deg, 400.0, heading_deg, route_m, picture, SIGMA_M, "gps")
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
        write_drive(folder / f"{number}-{view}-{light}", drive, view, light=light)
    return folder


def rebuilt(scene: Scene, seed: int, other: int, places: slice) -> Callable[[View, LightName, int], Described]:
    """Drives over a road of which a part looks like that of another seed."""

    def after(view: View, light: LightName, drive: int) -> Described:
        before = scene(seed, view, light, drive)
        raw = before.raw.copy()
        raw[places] = scene(other, view, light, drive).raw[places]
        return replace(before, raw=raw)

    return after


def keep_lesson(folder: Path) -> Lesson:
    """Learn, and let it hold."""
    lesson = learn(folder)
    lesson.keep(LearnedFolder(folder))
    return lesson


def learned_rows(seeds: Sequence[int], scene: Scene) -> Iterator[str]:
    """A row for each folder, with the roads side by side."""
    yield "| folder | places searched | dusk, same way | home at night | least precision |\n|---|---|---|---|---|"
    found: dict[str, list[list[list[float]]]] = {}
    for seed in seeds:
        made = _eight(seed, scene)
        queries: dict[LightName, Described] = {
            "dusk": scene(seed, "front", "dusk", 21),
            "night": scene(seed, "front", "night", 22, "reverse"),
        }
        with tempfile.TemporaryDirectory() as temporary:
            first, every = folder_of(Path(temporary) / "one", made[:1]), folder_of(Path(temporary) / "all", made)
            for what in ("first rear drive", "all eight", "learned", "learned, after counting"):
                if what.startswith("learned"):
                    keep_lesson(every)
                results, folder = [], first if what == "first rear drive" else every
                for light, query in queries.items():
                    with closing(DriveTally(folder, "front", time.time(), f"{light}-{what}")) as tally:
                        results.append(drive_over(folder, query, light, tally))
                found.setdefault(what, []).append(results)
    for what, roads in found.items():
        cells = (
            f"{', '.join(f'{first_m:.0f}' for first_m, *_ in way)} m; {', '.join(f'{one[1]:.2f}' for one in way)}"
            for way in zip(*roads, strict=True)
        )
        precision = min(way[2] for road in roads for way in road)
        yield f"| {what} | {roads[0][0][3]:.0f} | {' | '.join(cells)} | {precision:.3f} |"


def rebuilt_rows(seeds: Sequence[int], scene: Scene) -> Iterator[str]:
    """A row for each road: recall after each drive since it was rebuilt."""
    drives = ", ".join(f"{number}" for number in range(len(NEW) + 1))
    yield f"| seed | places searched | recall on the rebuilt tenth after {drives} drives |\n|---|---|---|"
    for seed, other in zip(seeds, [*seeds[1:], seeds[0]], strict=True):
        after = rebuilt(scene, seed, other, REBUILT)
        recalls, most_places = [], 0.0
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary)
            for view, light, drive in OLD:
                write_drive(folder / f"old-{view}-{light}", scene(seed, view, light, drive), view)
            for number, (_, light, drive) in enumerate((("", "dusk", 0), *NEW)):
                if number:
                    write_drive(folder / f"new-{number}", after("front", light, drive), "front")
                    keep_lesson(folder)
                for run in range(2):
                    with closing(DriveTally(folder, "front", time.time(), f"{number}-{run}")) as tally:
                        _, recall, _, places = drive_over(folder, after("front", "dusk", 21), "dusk", tally, REBUILT)
                recalls.append(recall)
                most_places = max(most_places, places)
        yield f"| {seed} | {most_places:.0f} | {', '.join(f'{recall:.2f}' for recall in recalls)} |"


def shifted_rows(seeds: Sequence[int], scene: Scene) -> Iterator[str]:
    """A row for each road: drives that are wrong, one at a time, of eight whose receivers are off by SIGMA_M."""
    yield (
        "| seed | wrong drives, of which it alone was named | others moved by it, at most |"
        " errors of the others, as recorded and learned |\n|---|---|---|---|"
    )
    for seed in seeds:
        made, rng = _eight(seed, scene), np.random.default_rng(seed)
        off_m = [SIGMA_M / np.sqrt(2) * receiver_errors(len(one.route_m), 2.0, 200.0, rng) for *_, one in made]
        named: list[bool] = []
        moved_m, before_m, after_m = [], [], []
        for number in SHIFTED:
            others = [one for one in range(len(made)) if one != number]
            _, without = _positions([made[one] for one in others], [off_m[one] for one in others])
            before_m.append(_rms([off_m[one] for one in others]))
            for half in (False, True):
                wrong = list(off_m)
                rows = np.arange(len(wrong[number])) >= (len(wrong[number]) // 2 if half else 0)
                wrong[number] = wrong[number] + np.outer(rows, (ASIDE_M, 0.0))
                lesson, now = _positions(made, wrong)
                retired = [one for one, why in lesson.choice.retired.items() if "from where" in why]
                named.append([lesson.drives[one].path.name.partition("-")[0] for one in retired] == [f"{number}"])
                moved_m += [np.hypot(*(now[one] - at).T).max() for one, at in zip(others, without, strict=True)]
                after_m.append(_rms([now[one] - _true(made[one][2]) for one in others]))
        yield (
            f"| {seed} | {len(named)}, {sum(named)} | {max(moved_m):.2f} m"
            f" | {min(before_m):.2f} to {max(before_m):.2f}, {min(after_m):.2f} to {max(after_m):.2f} m |"
        )


def hundred_rows(seeds: Sequence[int], scene: Scene) -> Iterator[str]:
    """A row for each number of drives; those after the eighth are the same with noise of their own."""
    yield "| seed | drives | places | searched | MB searched | learning a km, s of a core |\n|---|---|---|---|---|---|"
    for seed in seeds[:1]:
        made, rng = _eight(seed, scene), np.random.default_rng(seed)
        with tempfile.TemporaryDirectory() as temporary:
            for number in range(HUNDRED):
                view, light, drive = made[number % 8]
                noise = 0.3 * drive.raw.std() * rng.standard_normal(drive.raw.shape, np.float32) * (number >= 8)
                write_drive(Path(temporary) / f"{number:02}", replace(drive, raw=drive.raw + noise), view, light=light)
                if number + 1 in (1, 4, 8, HUNDRED):
                    began_s = time.process_time()
                    keep_lesson(Path(temporary))
                    took_s, maps = time.process_time() - began_s, open_map_set(Path(temporary))
                    mb = sum(one.descriptors.nbytes for one in maps.maps) / 1e6
                    km = np.ptp(drive.route_m) / 1000
                    places = sum(one.header.places for one in open_map_set(Path(temporary), as_recorded=True).maps)
                    yield (f"| {seed} | {number + 1} | {places} | {maps.index.places} | {mb:.1f} | {took_s / km:.1f} |")


def draw(picture: Path, seeds: Sequence[int], scene: Scene, length_m: float) -> None:
    """Four drives, then 200 m of the road are rebuilt; three drives pass, and four more become layers."""
    seed, other = seeds[:2]
    road = Scenario(seed=seed, length_m=length_m).drive().route
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for view, light, drive in (*OLD, DRIVES[1]):
            write_drive(folder / f"old-{view}-{light}", scene(seed, view, light, drive), view, light=light, road=road)
        after = rebuilt(scene, seed, other, PICTURED)
        later = after("front", "dusk", 21)
        for run, one in enumerate((scene(seed, "front", "dusk", 21), later, later, later)):
            with closing(DriveTally(folder, "front", time.time(), f"{run}")) as tally:
                drive_over(folder, one, "dusk", tally, knows_course=False)
        keep_lesson(folder)
        for view, light, drive in NEW:
            write_drive(folder / f"rebuilt-{view}-{light}", after(view, light, drive), view, light=light, road=road)
        lesson = keep_lesson(folder)
        write_layers(picture, folder, lesson)
    note_sources(picture.parent, picture.name)


def _eight(seed: int, scene: Scene) -> list[tuple[View, LightName, Described]]:
    return [(view, light, scene(seed, view, light, drive)) for view, light, drive in DRIVES]


def _true(drive: Described) -> Floats:
    return np.stack([np.zeros(len(drive.route_m)), drive.route_m], axis=1)


def _rms(errors_m: Sequence[Floats]) -> float:
    return float(np.sqrt(np.mean(np.concatenate([np.sum(one**2, axis=1) for one in errors_m]))))


def _positions(
    made: Sequence[tuple[View, LightName, Described]], off_m: Sequence[Floats]
) -> tuple[Lesson, list[Floats]]:
    """What is learned, and where each drive then is: meters (N, 2) east and north."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for number, ((view, light, drive), off) in enumerate(zip(made, off_m, strict=True)):
            write_drive(folder / f"{number}-{view}-{light}", drive, view, off)
        lesson = keep_lesson(folder)
        learned = LearnedFolder(folder)
        recorded = open_map_set(folder, as_recorded=True).maps
        places = [learned.applied(one).places for one in recorded]
        return lesson, [east_north(one["lat_deg"], one["lon_deg"], ORIGIN) for one in places]


def while_learning_rows(seeds: Sequence[int], scene: Scene) -> Iterator[str]:
    """Rows of `learning_frames`, on maps of random numbers."""
    with tempfile.TemporaryDirectory() as temporary:
        yield from frames_rows(Path(temporary), Network.load())


TABLES: dict[str, Callable[[Sequence[int], Scene], Iterator[str]]] = {
    "learned": learned_rows,
    "rebuilt": rebuilt_rows,
    "shifted": shifted_rows,
    "hundred": hundred_rows,
    "frames": while_learning_rows,
}


def main() -> None:
    """Print the tables, or write them into a page."""
    parser = options(__doc__, 800.0)
    parser.add_argument("--tables", nargs="*", choices=TABLES, default=list(TABLES), help="all by default")
    parser.add_argument("--picture", type=Path, help="draw the layers of the first road")
    args = parser.parse_args()

    def scene(seed: int, view: View, light: LightName, drive: int, way: Direction = "forward") -> Described:
        scenario = Scenario(seed=seed, length_m=args.length, view=view, light=light, direction=way, drive_seed=drive)
        return described(scenario, args.cache)

    for name in args.tables:
        publish(name, TABLES[name](args.seeds, scene), args.page)
    if args.picture:
        draw(args.picture, args.seeds, scene, args.length)


if __name__ == "__main__":
    main()
