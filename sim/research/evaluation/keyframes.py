"""What is believed on maps with keypoints and on the same maps without: what `poses` finds drives for.

The daemon's own recognizer gets the frames of simulated drives, the course, and an odometer that counts 1 % too much.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

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
from sim.research.evaluation.roads import TOLERANCE_M, DriveDescriptors
from sim.world.scenario import LightName

LENGTH_M, SPACING_M = 500.0, 2.0
LIGHTS: dict[str, tuple[LightName, ...]] = {
    "front": ("dusk", "night", "snow", "rain"),
    "home": ("dusk", "night", "snow"),
}
OFF_MAP_LIGHTS: tuple[LightName, ...] = ("dusk", "night")
REPEATS_M = 54.0, 27.0, 12.0
"""After which the houses of a straight street repeat."""
STREET_LIGHTS: tuple[LightName, ...] = ("dusk", "night")
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


class DriveRecording:
    """A recorded drive; ground_m: (n, 2) meters east and north of the map's first place."""

    def __init__(self, path: Path, origin: tuple[float, float]) -> None:
        feed = read_feed(path)
        images = FeedImages(feed)
        self.images = [images.read(number) for number in range(len(feed.rows))]
        images.close()
        degrees = np.array([(row.lat_deg, row.lon_deg) for row in feed.rows], np.float64)
        self.ground_m = east_north(degrees[:, 0], degrees[:, 1], origin)

    def described(self, drive: int) -> DriveDescriptors:
        """With the numbers of drive and frame in place of descriptors."""
        driven_m = np.arange(len(self.images), dtype=np.float64) * SPACING_M
        frames = np.column_stack([np.full(len(driven_m), drive), np.arange(len(driven_m))])
        return DriveDescriptors(frames.astype(np.float32), driven_m, driven_m, self.ground_m)


@dataclass(frozen=True)
class RoadMap:
    """A road's map, and the drives on it by their lights."""

    reference: ReferenceMap
    drives: dict[LightName, DriveRecording]

    @cached_property
    def ground_m(self) -> NDArray[np.float64]:
        """Meters (N, 2) of the places."""
        places = self.reference.places
        return east_north(places["lat_deg"], places["lon_deg"], self.origin)

    @property
    def origin(self) -> tuple[float, float]:
        """Of these meters."""
        return float(self.reference.places["lat_deg"][0]), float(self.reference.places["lon_deg"][0])


class Bench:
    """The networks, which remember, and what drives over a map."""

    def __init__(self) -> None:
        self._network, self._keypoints = MemoizingNetwork.load(Path("grid")), MemoizingKeypoints()

    def answers(
        self,
        mapped: RoadMap,
        frames: Sequence[Image],
        ground_m: NDArray[np.float64],
        reckoned: Sequence[DeadReckoningPosition] | None = None,
        *,
        keypoints: bool,
        knows_course: bool = True,
    ) -> Iterator[PlaceMatch | None]:
        """To each frame, 2 m after the last one; frames with the same ground_m are those of a vehicle that stands."""
        one = mapped.reference
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


class Tables:
    """What is believed on the maps of some roads, and off them; draws: each finds the drives that it has."""

    def __init__(
        self,
        roads: Sequence[int],
        map_of: Callable[[int, str], ReferenceMap],
        draws: Sequence[Callable[[int, str, LightName], Path]],
    ) -> None:
        self._roads, self._map_of, self._draws, self._bench = roads, map_of, draws, Bench()

    def on_map(self, only: Sequence[LightName] | None = None) -> Iterator[str]:
        """Rows of the table by drive and light; only: some lights."""
        yield "| drive | light | first accepted | with keypoints | at rest | accepted | with keypoints | wrong |"
        yield "|---|---|---|---|---|---|---|---|"
        for drive, lights in LIGHTS.items():
            for light in (one for one in lights if only is None or one in only):
                seen = [one for draw in self._draws for one in self._mapped(drive, (light,), draw)]
                yield f"| {drive} | {light} | {' | '.join(_on_map(self._bench, seen, light))} |"

    def off_map(self) -> Iterator[str]:
        """Rows of the table by where the vehicle is, of the first draw."""
        seen = {drive: list(self._mapped(drive, OFF_MAP_LIGHTS, self._draws[0])) for drive in LIGHTS}
        yield "| a road that is not mapped | frames | accepted without keypoints | with them |"
        yield "|---|---|---|---|"
        for where in (NOWHERE, *LAYOUTS):
            confidences = [
                np.concatenate(list(_off_map(self._bench, seen, where, keypoints=keypoints)))
                for keypoints in (False, True)
            ]
            least = Config().acceptance.confidence_from
            cells = (f"{(one >= least).sum()}, at most {one.max():.3f}" for one in confidences)
            yield f"| {where} | {len(confidences[0])} | {' | '.join(cells)} |"

    def on_street(self, drive: str, light: LightName, seed: int) -> NDArray[np.intp]:
        """Counts (2, G, 3) of frames while driving and spots at rest, by `GPS_LOST_M`: all, believed, wrong.

        seed: of the errors of GPS and odometer.
        """
        found = np.zeros((2, len(GPS_LOST_M), 3), int)
        for draw in self._draws:
            for mapped in self._mapped(drive, (light,), draw):
                film = mapped.drives[light]
                for number, lost_m in enumerate(GPS_LOST_M.values()):
                    reckoned = None if lost_m is None else film.described(0).reckoned(lost_m, seed, mapped.origin)
                    answers = list(self._bench.answers(mapped, film.images, film.ground_m, reckoned, keypoints=True))
                    off_m = _off_m(mapped, answers, film.ground_m)
                    found[0, number] += len(off_m), np.isfinite(off_m).sum(), (off_m > ANOTHER_PLACE_M).sum()
                    for _, off_m in _standing(self._bench, mapped, film, reckoned):
                        found[1, number] += 1, np.isfinite(off_m).any(), (off_m > ANOTHER_PLACE_M).any()
        return found

    def _mapped(
        self, drive: str, lights: Sequence[LightName], draw: Callable[[int, str, LightName], Path]
    ) -> Iterator[RoadMap]:
        for road in self._roads:
            mapped = RoadMap(self._map_of(road, "front" if drive == "front" else "rear"), {})
            for light in lights:
                mapped.drives[light] = DriveRecording(draw(road, drive, light), mapped.origin)
            yield mapped


def _on_map(bench: Bench, roads: Sequence[RoadMap], light: LightName) -> Iterator[str]:
    """Meters to the first belief, what a standing vehicle believes, and all frames: without and with keypoints."""
    first_m: tuple[list[float], list[float]] = ([], [])
    believed, wrong, frames = [0, 0], [0, 0], 0
    standing = np.zeros(PICTURES + 1, int)
    for mapped in roads:
        film = mapped.drives[light]
        count = len(film.images)
        frames += count
        for keypoints in (False, True):
            answers = list(bench.answers(mapped, film.images, film.ground_m, keypoints=keypoints))
            off_m = _off_m(mapped, answers, film.ground_m)
            believed[keypoints] += int(np.isfinite(off_m).sum())
            wrong[keypoints] += int((off_m > TOLERANCE_M).sum())
            for start in range(0, count - 60, round(STARTS_M / SPACING_M)):
                rest = film.images[start:], film.ground_m[start:]
                again = answers if start == 0 else bench.answers(mapped, *rest, keypoints=keypoints)
                first = next((n for n, one in enumerate(again) if one is not None and one.accepted), np.inf)
                first_m[keypoints].append(first * SPACING_M)
        for answers, off_m in _standing(bench, mapped, film):
            found = next((n for n, one in enumerate(answers) if one is not None and one.accepted), PICTURES)
            wrong[True] += int((off_m > TOLERANCE_M).any())
            standing[found] += 1
    yield from (f"{np.median(one):.0f}, {np.percentile(one, 90):.0f} m" for one in first_m)
    shares = np.cumsum(standing)[:-1] / standing.sum()
    yield ", ".join(f"{share:.2f}" for share in shares[1:])
    yield from (f"{one / frames:.3f}" for one in believed)
    yield f"{', '.join(map(str, wrong))} of {frames}"


def _standing(
    bench: Bench, mapped: RoadMap, film: DriveRecording, reckoned: Sequence[DeadReckoningPosition] | None = None
) -> Iterator[tuple[list[PlaceMatch | None], NDArray[np.float64]]]:
    """The answers at spots along a drive, and how far they are off."""
    for start in range(0, len(film.images) - 10, round(STANDS_M / SPACING_M)):
        pictures = list(_stands(film.images[start]))
        at_m = np.repeat(film.ground_m[start : start + 1], len(pictures), axis=0)
        prior = reckoned and [reckoned[start]] * len(pictures)
        answers = list(bench.answers(mapped, pictures, at_m, prior, keypoints=True))
        yield answers, _off_m(mapped, answers, at_m)


def on_streets(streets: dict[float, Tables]) -> Iterator[str]:
    """Rows of the table of straight streets whose houses repeat after so many meters, and of all of them."""
    gps = " | ".join(GPS_LOST_M)
    yield f"| drive | light | houses repeat after | driving, {gps} | at rest, {gps} |"
    yield "|" + "---|" * (3 + 2 * len(GPS_LOST_M))
    every = np.zeros((2, len(GPS_LOST_M), 3), int)
    drives = product(streets.items(), LIGHTS, STREET_LIGHTS)
    for seed, ((repeats_m, tables), drive, light) in enumerate(drives):
        found = tables.on_street(drive, light, seed)
        every += found
        yield f"| {drive} | {light} | {repeats_m:g} m | {_counted(found)} |"
    yield f"| all | | | {_counted(every)} |"


def _counted(found: NDArray[np.intp]) -> str:
    """Cells of what `Tables.on_street` counts."""
    return " | ".join(f"{believed} of {count}, {wrong}" for count, believed, wrong in found.reshape(-1, 3))


def _stands(image: Image) -> Iterator[Image]:
    """Pictures from one spot."""
    rng = np.random.default_rng(0)
    for _ in range(PICTURES):
        yield (image + rng.normal(0, NOISE, image.shape)).round().clip(0, 255).astype(np.uint8)


def _off_m(mapped: RoadMap, answers: Sequence[PlaceMatch | None], ground_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Meters (n,) of each believed place from the vehicle, NaN where none is believed."""
    places = np.array([one.place_index if one is not None and one.accepted else -1 for one in answers])
    off_m = np.hypot(*(mapped.ground_m[places] - ground_m).T)
    return np.where(places >= 0, off_m, np.nan)


def _off_map(
    bench: Bench, seen: dict[str, list[RoadMap]], where: str, *, keypoints: bool
) -> Iterator[NDArray[np.float64]]:
    """The confidence of each frame on a road that is not mapped: of the next road, or of a twin, the own one."""
    for drive, roads in seen.items():
        for mapped, other in zip(roads, [*roads[1:], *roads[:1]], strict=True):
            line_m = mapped.ground_m[:: 1 if drive == "front" else -1]
            for light in OFF_MAP_LIGHTS:
                films = mapped.drives[light], other.drives[light]
                if where == NOWHERE:
                    found = bench.answers(
                        mapped, films[1].images, films[1].ground_m, keypoints=keypoints, knows_course=False
                    )
                    yield _confidence(found)
                    continue
                for layout in LAYOUTS[where]:
                    laid, is_off = layout(line_m, *(film.described(n) for n, film in enumerate(films)))
                    assert laid.east_north_m is not None
                    images = [films[drive_number].images[frame] for drive_number, frame in laid.raw.astype(int)]
                    reckoned = laid.reckoned(-1.0, len(images), mapped.origin)
                    found = bench.answers(mapped, images, laid.east_north_m, reckoned, keypoints=keypoints)
                    yield _confidence(found)[is_off]


def _confidence(answers: Iterator[PlaceMatch | None]) -> NDArray[np.float64]:
    return np.array([one.confidence if one else 0.0 for one in answers])
