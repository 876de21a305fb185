"""What is believed on maps with keypoints and on the same maps without, on and off the map, and on streets built alike.

The daemon's own recognizer gets the frames of simulated drives, the course, and an odometer that counts 1 % too much.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from edge import __version__
from edge.config import Config, DescriptorConfig
from edge.feed import FeedImages, read_feed
from edge.geodesy import east_north
from edge.keypoints import Keypoints
from edge.keypoints.network import KeypointNetwork
from edge.localization import Odometry
from edge.localization.dead_reckoning import TurnAround
from edge.recognition.recognizer import open_recognizer
from edge.reference_map import MapSet, ReferenceMap
from edge.sequence import DeadReckoningPosition, MotionPrior, PlaceMatch
from sim.evaluation.memoizing_network import MemoizingNetwork
from sim.research.evaluation.belief import LAYOUTS
from sim.research.evaluation.poses import DRIVES, mapped
from sim.research.evaluation.roads import TOLERANCE_M, DriveDescriptors
from sim.world.recording import recorded
from sim.world.scenario import LightName, Scenario

LENGTH_M, SPACING_M = 500.0, 2.0
DRAWS = 100
"""Between the seeds of two draws of a drive: of its speed, other cars, lit windows and noise."""
LIGHTS: dict[str, tuple[LightName, ...]] = {
    "front": ("dusk", "night", "snow", "rain"),
    "home": ("dusk", "night", "snow"),
}
DARK: tuple[LightName, ...] = ("dusk", "night")
"""Off the map, and on streets built alike."""
REPEATS_M = 54.0, 27.0, 12.0
"""After which the houses of a straight street repeat."""
ANOTHER_PLACE_M = 20.0
"""From which a place that is believed there is another one."""
GPS_LOST_M = {"no GPS": None, "GPS lost at the start": 0.0, "GPS": -1.0}
"""As `DriveDescriptors.reckoned` has it."""
STARTS_M, STANDS_M = 160.0, 40.0
"""Between the starts of a vehicle that drives, and between those of one that stands."""
PICTURES, NOISE = 4, 2.0
"""Of one that stands, and the standard deviation in which they differ."""
SCALE, STEP_NS, STANDS_NS = 1.01, 200_000_000, 1_000_000_000
NOWHERE = "anywhere; course and position are not known"
Image = NDArray[np.uint8]
Floats = NDArray[np.float64]


class MemoizingKeypoints(KeypointNetwork):
    """A picture that it has seen before is not computed again."""

    def __init__(self) -> None:
        super().__init__()
        self._known: dict[int, Keypoints] = {}

    def extract(self, image: Image, most: int = 0) -> Keypoints:
        """See `KeypointNetwork`."""
        key = hash(image.tobytes())
        if key not in self._known:
            self._known[key] = super().extract(image, most)
        return self._known[key]


@dataclass(frozen=True)
class DriveOnMap:
    """A drive on a map. ground_m, places_m: of its frames (n, 2) and of the places (N, 2), east and north of origin."""

    reference: ReferenceMap
    origin: tuple[float, float]
    images: list[Image]
    ground_m: Floats
    places_m: Floats

    def described(self, drive: int) -> DriveDescriptors:
        """With the numbers of drive and frame in place of descriptors."""
        driven_m = np.arange(len(self.images), dtype=np.float64) * SPACING_M
        frames = np.column_stack([np.full(len(driven_m), drive), np.arange(len(driven_m))])
        return DriveDescriptors(frames.astype(np.float32), driven_m, driven_m, self.ground_m)

    def off_m(self, answers: Sequence[PlaceMatch | None], ground_m: Floats) -> Floats:
        """Meters (n,) of each believed place from the vehicle, NaN where none is believed."""
        places = np.array([one.place_index if one is not None and one.accepted else -1 for one in answers])
        return np.where(places >= 0, np.hypot(*(self.places_m[places] - ground_m).T), np.nan)


class Bench:
    """The networks, which remember, and what drives over a map."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._network, self._keypoints = MemoizingNetwork.load(Path("grid")), MemoizingKeypoints()

    def mapped(self, road: int, drive: str, light: LightName, draw: int = 0, repeats_m: float = 0) -> DriveOnMap:
        """A drive in that light, and the map of its road."""
        view, made = DRIVES[drive]
        of = {"seed": road, "length_m": LENGTH_M, "repeats_m": repeats_m}
        reference = mapped(self._folder, Scenario(**of), view)  # type: ignore[arg-type]  # keys by name
        scenario = msgspec.structs.replace(made, light=light, drive_seed=made.drive_seed + DRAWS * draw, **of)
        feed = read_feed(recorded(scenario, self._folder, SPACING_M))
        images = FeedImages(feed)
        seen = [images.read(number) for number in range(len(feed.rows))]
        images.close()
        places = reference.places
        origin = float(places["lat_deg"][0]), float(places["lon_deg"][0])
        degrees = np.array([(row.lat_deg, row.lon_deg) for row in feed.rows], np.float64)
        places_m = east_north(places["lat_deg"], places["lon_deg"], origin)
        return DriveOnMap(reference, origin, seen, east_north(degrees[:, 0], degrees[:, 1], origin), places_m)

    def answers(
        self,
        on: DriveOnMap,
        frames: Sequence[Image],
        ground_m: Floats,
        reckoned: Sequence[DeadReckoningPosition] | None = None,
        *,
        keypoints: bool,
        knows_course: bool = True,
    ) -> Iterator[PlaceMatch | None]:
        """To each frame, 2 m after the last one; frames with the same ground_m are those of a vehicle that stands."""
        one = on.reference
        one = one if keypoints else replace(one, header=one.header.with_keypoints(None))
        config = Config(descriptor=DescriptorConfig(model="grid"))
        recognizer = open_recognizer(config, network=self._network, map_set=MapSet.of(one))
        recognizer.matcher.use_keypoints(self._keypoints)
        turned, driven_m, stamp_ns = TurnAround(), 0.0, 0
        for number, (image, at_m) in enumerate(zip(frames, ground_m, strict=True)):
            stands = number > 0 and np.array_equal(at_m, ground_m[number - 1])
            if not stands:
                turned.add(Odometry(0, *at_m.tolist()))
            driven_m += SPACING_M * SCALE * (number > 0 and not stands)
            stamp_ns += STANDS_NS if stands else STEP_NS
            course_rad = turned.course_rad if knows_course else None
            travel = MotionPrior(driven_m, course_rad=course_rad, dead_reckoning=reckoned[number] if reckoned else None)
            if not stands:
                yield recognizer.observe(image, stamp_ns, travel)
            elif recognizer.may_verify_again(stamp_ns, driven_m):
                yield recognizer.verify_again(image, stamp_ns, travel)
            else:
                yield None

    def standing(
        self, on: DriveOnMap, reckoned: Sequence[DeadReckoningPosition] | None = None
    ) -> Iterator[tuple[list[PlaceMatch | None], Floats]]:
        """The answers at spots along a drive, and how far they are off."""
        for start in range(0, len(on.images) - 10, round(STANDS_M / SPACING_M)):
            rng = np.random.default_rng(0)
            noisy = (on.images[start] + rng.normal(0, NOISE, on.images[start].shape) for _ in range(PICTURES))
            pictures = [one.round().clip(0, 255).astype(np.uint8) for one in noisy]
            at_m = np.repeat(on.ground_m[start : start + 1], PICTURES, axis=0)
            prior = reckoned and [reckoned[start]] * PICTURES
            answers = list(self.answers(on, pictures, at_m, prior, keypoints=True))
            yield answers, on.off_m(answers, at_m)


def on_map(args: argparse.Namespace) -> Iterator[str]:
    """What the recognizer believes, with keypoints and without."""
    bench = Bench(args.cache)
    yield "| drive | light | first accepted | with keypoints | at rest | accepted | with keypoints | wrong |"
    yield "|---|---|---|---|---|---|---|---|"
    for drive, lights in LIGHTS.items():
        for light in lights:
            drawn = product(range(args.draws), args.seeds)
            cells = _on_map(bench, (bench.mapped(road, drive, light, draw) for draw, road in drawn))
            yield f"| {drive} | {light} | {' | '.join(cells)} |"


def _on_map(bench: Bench, drives: Iterator[DriveOnMap]) -> Iterator[str]:
    """Meters to the first belief, what a standing vehicle believes, and all frames: without and with keypoints."""
    first_m: tuple[list[float], list[float]] = ([], [])
    believed, wrong, frames = [0, 0], [0, 0], 0
    standing = np.zeros(PICTURES + 1, int)
    for on in drives:
        count = len(on.images)
        frames += count
        for keypoints in (False, True):
            answers = list(bench.answers(on, on.images, on.ground_m, keypoints=keypoints))
            off_m = on.off_m(answers, on.ground_m)
            believed[keypoints] += int(np.isfinite(off_m).sum())
            wrong[keypoints] += int((off_m > TOLERANCE_M).sum())
            for start in range(0, count - 60, round(STARTS_M / SPACING_M)):
                rest = on.images[start:], on.ground_m[start:]
                again = answers if start == 0 else bench.answers(on, *rest, keypoints=keypoints)
                first_m[keypoints].append(_first(again, np.inf) * SPACING_M)
        for answers, off_m in bench.standing(on):
            wrong[True] += int((off_m > TOLERANCE_M).any())
            standing[int(_first(answers, PICTURES))] += 1
    yield from (f"{np.median(one):.0f}, {np.percentile(one, 90):.0f} m" for one in first_m)
    shares = np.cumsum(standing)[:-1] / standing.sum()
    yield ", ".join(f"{share:.2f}" for share in shares[1:])
    yield from (f"{one / frames:.3f}" for one in believed)
    yield f"{', '.join(map(str, wrong))} of {frames}"


def _first(answers: Iterator[PlaceMatch | None] | Sequence[PlaceMatch | None], otherwise: float) -> float:
    """The number of the first frame whose place is believed."""
    return next((number for number, one in enumerate(answers) if one is not None and one.accepted), otherwise)


def on_streets(args: argparse.Namespace) -> Iterator[str]:
    """What it believes on straight streets whose houses repeat: of all frames or spots, and how many of it is wrong."""
    seeds = " ".join(map(str, args.seeds))
    yield f"`python -m sim.research.evaluation streets --seeds {seeds}` of version {__version__}:\n"
    gps = " | ".join(GPS_LOST_M)
    yield f"| houses repeat after | driving, {gps} | at rest, {gps} |"
    yield "|" + "---|" * (1 + 2 * len(GPS_LOST_M))
    bench = Bench(args.cache)
    for repeats_m in REPEATS_M:
        found = np.zeros((2, len(GPS_LOST_M), 3), int)
        for seed, (drive, light, road) in enumerate(product(LIGHTS, DARK, args.seeds)):
            on = bench.mapped(road, drive, light, repeats_m=repeats_m)
            for number, lost_m in enumerate(GPS_LOST_M.values()):
                reckoned = None if lost_m is None else on.described(0).reckoned(lost_m, seed, on.origin)
                answers = list(bench.answers(on, on.images, on.ground_m, reckoned, keypoints=True))
                off_m = on.off_m(answers, on.ground_m)
                found[0, number] += len(off_m), np.isfinite(off_m).sum(), (off_m > ANOTHER_PLACE_M).sum()
                for _, off_m in bench.standing(on, reckoned):
                    found[1, number] += 1, np.isfinite(off_m).any(), (off_m > ANOTHER_PLACE_M).any()
        cells = (f"{believed} of {count}, {wrong}" for count, believed, wrong in found.reshape(-1, 3))
        yield f"| {repeats_m:g} m | {' | '.join(cells)} |"


def off_map(args: argparse.Namespace) -> Iterator[str]:
    """What it believes where no place is right."""
    bench = Bench(args.cache)
    yield "| a road that is not mapped | frames | accepted without keypoints | with them |"
    yield "|---|---|---|---|"
    for where in (NOWHERE, *LAYOUTS):
        each = [np.concatenate(list(_off_map(bench, args.seeds, where, keypoints=one))) for one in (False, True)]
        cells = (f"{(one >= Config().acceptance.confidence_from).sum()}, at most {one.max():.3f}" for one in each)
        yield f"| {where} | {len(each[0])} | {' | '.join(cells)} |"


def _off_map(bench: Bench, seeds: Sequence[int], where: str, *, keypoints: bool) -> Iterator[Floats]:
    """The confidence of each frame on a road that is not mapped: of the next road, or of a twin, the own one."""
    for drive, light, road, other in (
        (*one, *pair) for one in product(LIGHTS, DARK) for pair in zip(seeds, [*seeds[1:], *seeds[:1]], strict=True)
    ):
        both = [bench.mapped(one, drive, light) for one in (road, other)]
        on, line_m = both[0], both[0].places_m[:: 1 if drive == "front" else -1]
        if where == NOWHERE:
            there = both[1].images, both[1].ground_m
            yield _confidence(bench.answers(on, *there, keypoints=keypoints, knows_course=False))
            continue
        for layout in LAYOUTS[where]:
            laid, is_off = layout(line_m, *(one.described(number) for number, one in enumerate(both)))
            images = [both[drive_number].images[frame] for drive_number, frame in laid.raw.astype(int)]
            found = bench.answers(
                on, images, laid.east_north_m, laid.reckoned(-1.0, len(images), on.origin), keypoints=keypoints
            )
            yield _confidence(found)[is_off]


def _confidence(answers: Iterator[PlaceMatch | None]) -> Floats:
    return np.array([one.confidence if one else 0.0 for one in answers])
