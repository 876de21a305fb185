"""`lookback try`: from two recordings to a verdict: is the place recognized, where not, why, and what to change."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from edge.camera.picture_check import PictureFaultDetector
from edge.camera.preprocessing import preprocessed_feed
from edge.config import FIRST_NETWORK, CameraConfig, Config, DescriptorConfig, SamplingConfig
from edge.errors import ConfigError, FeedError, MapError
from edge.feed import Feed, FeedImages, FeedOptions, View, read_feed
from edge.reference_map import MapSet, open_map, open_map_set
from sim.calibration.command import Lines, as_toml, measure_rig, rig_lines
from sim.calibration.offset import Offset, rig_config
from sim.datasets import ReadOptions, Traverse, open_dataset
from sim.datasets.alignment import Alignment
from sim.datasets.found import find_kind
from sim.datasets.importing import choose_rows, write_feed
from sim.evaluation.command import add_tolerance_option
from sim.evaluation.memoizing_network import MemoizingNetwork
from sim.evaluation.pose_errors import pose_errors
from sim.evaluation.recognition import Recognition, RecognitionScore, judge, recognize
from sim.evaluation.replay import as_line
from sim.first_try.verdict import TryResult, Verdict, verdict
from sim.first_try.with_keypoints import WithKeypoints
from sim.maps.adding_keypoints import add_fov_option, camera_from, key_of_feeds
from sim.maps.command import add_spacing_options, build_map, sampling_from
from sim.maps.known_distances import spell_distances
from sim.output import calling, needing, replacing
from sim.traverse import check_origins, config_as_mapped, driven_m, is_local

ROLES = ("reference", "query")
FITTED_AT = SamplingConfig(by="time", interval_s=0.2)
"""Which frames of a query without meters are kept, for any pace to be chosen of: one every 2 m at 10 m/s."""
PACES = tuple(2 ** (step / 3) for step in (0, 1, -1, 2, -2, 3, -3, 4, -4, 5, -5, 6, -6))
"""Of a query, from a quarter to four times the expected one. Sequences are found at up to 1.2 times the map's pace."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of `lookback try`."""
    parser.description = (
        "Build a map of one recording, recognize its places in another, and say how well: one page, and a few lines."
        " A recording is a feed, a video with its log or track of the same name (.gpx, .csv, .tlog and others), a"
        " folder of pictures with a CSV file or EXIF positions, or another layout that `lookback import` knows. Without"
        " positions the query is compared at the pace that fits best, and right is not separated from wrong."
    )
    parser.add_argument("reference", metavar="REFERENCE", type=Path, help="the recording to map")
    parser.add_argument("query", metavar="QUERY", type=Path, help="the recording to recognize it in")
    about = "folder of the map, the page and all else (default try)"
    parser.add_argument("-o", "--output", metavar="FOLDER", type=Path, default=Path("try"), help=about)
    for role in ROLES:
        parser.add_argument(f"--{role}-view", choices=("front", "rear"), help="where its camera looked (default front)")
        parser.add_argument(f"--{role}-positions", metavar="FILE", help="its track, log or CSV file, of another name")
        about = "seconds from the track's first position to the video's start (default: by what both show)"
        parser.add_argument(f"--{role}-offset-s", metavar="S", type=float, help=about)
    add_tolerance_option(parser)
    add_fov_option(parser)
    add_spacing_options(parser)
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    with needing("try:", "eval"):
        import sim.first_try.page  # noqa: F401  # it needs matplotlib: known before the work begins
    if not args.tolerance_m > 0:
        raise ConfigError(f"--tolerance-m: {args.tolerance_m:g} is not above 0")
    # Both before anything is written: a wrong path or option costs no time.
    opened = {role: _open(args, role) for role in ROLES}
    sampling = sampling_from(args, SamplingConfig())
    blind = [name for name in ROLES if not _has_meters(opened[name])]
    is_fitted = sampling.by == "distance" and bool(blind) and args.spacing_m is None
    if is_fitted:
        if "reference" in blind:
            sampling = msgspec.structs.replace(sampling, by="time")
        print(f"no positions in the {' and the '.join(blind)}: the query is compared at the pace that fits best")
    with replacing(args.output, "try") as folder, calling(folder, args.output):
        feeds = {
            "reference": _feed(opened["reference"], folder / "reference", sampling),
            "query": _feed(
                _as_traverse(opened["query"]) if is_fitted else opened["query"],
                folder / "query",
                FITTED_AT if is_fitted else sampling,
            ),
        }
        aligned = {role: one.alignment for role, one in opened.items() if isinstance(one, Traverse)}
        found = _try(args, feeds, aligned, folder, sampling, is_fitted=is_fitted)
    print("\n".join(["", found.headline, *(f"  {fact}" for fact in found.facts)]))
    for number, line in enumerate(found.advice, start=1):
        print(f"  {'to change: ' if number == 1 else '           '}{line}")
    there: Path = args.output
    print(f"page: {there / 'report.html'}   map: {there / 'map'}   config: {there / 'lookback.toml'}")
    return 0


def _try(
    args: argparse.Namespace,
    feeds: Mapping[str, Feed],
    aligned: Mapping[str, Alignment | None],
    folder: Path,
    sampling: SamplingConfig,
    *,
    is_fitted: bool,
) -> Verdict:
    """Make the map, recognize, and write all into the folder. is_fitted: at which pace the query is, is found out."""
    from sim.first_try.page import render

    reference, query = (feeds[role] for role in ROLES)
    check_origins(query, [reference.header.origin or reference.header.name], are_local=is_local(reference))
    print(f"1. Map of {args.reference}", flush=True)
    key = None if driven_m(reference) is None else key_of_feeds([reference])
    build_map([reference], folder / "map", DescriptorConfig(model=FIRST_NETWORK), sampling, keypoints=key)
    maps = open_map_set(folder / "map")
    plain = MapSet.of(replace(maps.maps[0], header=maps.headers[0].with_keypoints(None)))
    print(f"2. Recognizing {args.query}", flush=True)
    network = MemoizingNetwork.load(Path(FIRST_NETWORK))  # the frames are recognized several times
    offsets, why = _measure(folder / "map", query, network)
    config = msgspec.structs.replace(config_as_mapped(maps.headers[0]), rig=rig_config(offsets))
    if is_fitted:
        config = _fitted(config, plain, query, network)
    watch = _Watch()
    seen = recognize(maps, replace(query, pictures=lambda: _ImageTap(FeedImages(query), watch)), config, network)
    if not seen.used:
        raise FeedError(f"{query.path}: no picture shows anything: {seen.camera}")
    judged, with_keypoints = _judged(maps, seen, args.tolerance_m), None
    if key is not None:
        alone = recognize(plain, query, config, network)
        errors, known = pose_errors(maps, seen, config.rig), tuple(spell_distances(maps.maps[0]))
        with_keypoints = WithKeypoints(alone, _judged(plain, alone, args.tolerance_m), errors, known)
    rows = [one.frame for one in seen.used]
    gray, faults = np.array([watch.gray[row] for row in rows]), tuple(watch.faults.get(row, "") for row in rows)
    measured = tuple(offsets), why
    tried = TryResult(
        reference, query, maps, config, seen, judged, args.tolerance_m, gray, faults, *measured, with_keypoints
    )
    found, lines = verdict(tried), rig_lines(offsets)
    (folder / "frames.jsonl").write_text("".join(map(as_line, seen.used)), encoding="utf-8")
    (folder / "lookback.toml").write_text(_config_text(lines), encoding="utf-8")
    (folder / "report.html").write_text(render(tried, found, lines, aligned), encoding="utf-8")
    return found


def _judged(maps: MapSet, seen: Recognition, tolerance_m: float) -> RecognitionScore | None:
    """None without positions in both."""
    try:
        return judge(maps, seen, tolerance_m)
    except (FeedError, MapError):
        return None


def _open(args: argparse.Namespace, role: str) -> Feed | Traverse:
    """A recording: a feed, or what has to be converted to one. FeedError."""
    path: Path = getattr(args, role)
    view: View | None = getattr(args, f"{role}_view")
    positions, offset_s = getattr(args, f"{role}_positions"), getattr(args, f"{role}_offset_s")
    kind = find_kind(path, positions)
    camera = camera_from(args, CameraConfig())
    if kind is None and path.is_dir():
        for option, value in (("view", view), ("positions", positions), ("offset-s", offset_s)):
            if value is not None:
                raise ConfigError(f"--{role}-{option}: {path} is a feed; edit its feed.toml or frames.csv instead")
        return preprocessed_feed(read_feed(path), camera)
    if kind is None:
        return preprocessed_feed(read_feed(path, FeedOptions(view, offset_s=offset_s)), camera)
    said = ReadOptions(positions=positions, offset_s=offset_s, view=view, fov_deg=args.fov_deg)
    return open_dataset(kind, path, said)


def _has_meters(one: Feed | Traverse) -> bool:
    if isinstance(one, Feed):
        return driven_m(one) is not None
    return any(row.lat_deg is not None or row.distance_m is not None for row in one.rows)


def _feed(one: Feed | Traverse, output: Path, sampling: SamplingConfig) -> Feed:
    """A recording as a feed: read in place where it is one, else converted into a folder. FeedError."""
    if isinstance(one, Feed):
        return one
    write_feed(one, output, tqdm(choose_rows(one, sampling), unit="frame", desc=f"reading {one.name}", disable=None))
    return read_feed(output)


def _as_traverse(one: Feed | Traverse) -> Traverse:
    """A recording of which a part is copied, whatever it is."""
    if isinstance(one, Traverse):
        return one
    header = one.header
    kept = Traverse(header.name, one.path.name, one.rows, FeedImages(one), header.view)
    return replace(kept, fov_deg=header.fov_deg, lens=header.alone)


def _fitted(config: Config, maps: MapSet, query: Feed, network: MemoizingNetwork) -> Config:
    """The config with frames at the interval at which most are believed: nothing says how fast the query was."""
    places = max(maps.index.places - 1, 1)
    lasts_s = (query.rows[-1].stamp_ns - query.rows[0].stamp_ns) / 1e9
    step_s = lasts_s / max(len(query.rows) - 1, 1)
    usual_s = config.sampling.interval_s if config.sampling.by == "time" else lasts_s / places
    intervals_s = dict.fromkeys(max(usual_s * pace, step_s) for pace in PACES)
    tried = []
    for interval_s in intervals_s:
        # Half a step early is on time: the frames have times of their own.
        sampling = SamplingConfig(by="time", interval_s=max(interval_s - step_s / 2, 0.001))
        tried.append(msgspec.structs.replace(config, sampling=sampling))
    return max(tried, key=lambda one: recognize(maps, query, one, network).believed.mean())


def _measure(map_path: Path, query: Feed, network: MemoizingNetwork) -> tuple[list[Offset], str]:
    """The camera's offsets; where there are none, also why."""
    try:
        return measure_rig(open_map(map_path), [query], network=network)[0], "too few places are accepted"
    except (FeedError, MapError) as error:
        return [], str(error).replace(f"{map_path.parent}/", "")  # which is written under another name, see `replacing`


@dataclass
class _Watch:
    """What the daemon would find wrong with the pictures of some rows, and their mean gray levels."""

    gray: dict[int, float] = field(default_factory=dict)
    faults: dict[int, str] = field(default_factory=dict)


@dataclass
class _ImageTap:
    """Pictures that are checked while they are read."""

    images: FeedImages
    watch: _Watch
    detector: PictureFaultDetector = field(default_factory=PictureFaultDetector)

    def read(self, index: int) -> NDArray[np.uint8]:
        image = self.images.read(index)
        self.watch.gray[index] = float(image.mean())
        fault = self.detector.check(image, index, None)
        if fault is not None:
            self.watch.faults[index] = fault.what
        return image

    def close(self) -> None:
        self.images.close()


def _config_text(rig: Lines) -> str:
    """A config with which `eval`, `replay` and `run` know what was measured."""
    text = f'[descriptor]\nmodel = "{FIRST_NETWORK}"\n\n[map]\npath = "map"\n'
    return f"{text}{as_toml(rig)}\n" if rig else text
