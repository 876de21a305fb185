"""A plan: which traverses, which pairs of them, which methods. One TOML file, checked whole.

title = "My street"
methods = ["Raw-single", "Raw-fc6", "NSD-CR", "Lookback", "NSD-single@cosplace", "SeqSLAM"]   # NAME or NAME@NETWORK
seeds = [6101, 6113]        # the scenarios on these roads instead of their own: each pair on each
region_width = 0.4          # of each region of NSD-CR, fraction of the picture
resamples = 1000            # of the bootstrap

[sampling]                  # as in Lookback's configuration
by = "distance"
spacing_m = 2.0

[networks.grid]             # the first is the default; without any it is the grid
model = "grid"              # or "fc6"; or a file, under --models or beside the plan
[networks.cosplace]
model = "cosplace.onnx"     # any ONNX network; also: size = [height, width], mean and std of each channel
[networks.netvlad]
descriptors = { day_rear = "rear.npy", dusk_front = "front.npy" }  # made elsewhere: (n, D), a row for each frame

[traverses.day_rear]
feed = "day_rear"           # a recording or a folder of pictures, under --feeds or beside the plan; or:
feeds = ["a_rear", "b_rear"]  # several, each a drive of its own; or:
scenario = "day_rear.toml"  # a drive of the simulator, rendered once

[[pairs]]
name = "front against rear, dusk"
reference = "day_rear"
query = "dusk_front"
truth = "positions"         # or rows, route_m, anchors, FILE.npy: see `Pair`
tolerance = 40.0            # meters; frames with truth = "rows" or "anchors"
ahead = 28.0                # how far ahead the matched place lies, or: calibration = "another traverse"
length_m = 40.0             # of a sequence; or length = 20, in frames
directions = "forward"      # where it is known how the query passes the reference (default: both)
figure = "fig. 5"           # the paper's figure of the same comparison
"""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import msgspec
from msgspec import Meta, Struct
from msgspec.structs import replace

from edge.config import SamplingConfig
from edge.errors import ConfigError
from edge.toml_file import convert_toml, read_toml

TRUTHS = ("positions", "rows", "route_m", "anchors")
Length = Annotated[int, Meta(ge=1, le=500)]
Positive = Annotated[float, Meta(gt=0)]
Pixels = Annotated[int, Meta(ge=8, le=4096)]
Seed = Annotated[int, Meta(ge=0, le=2**32 - 1)]
Named = TypeVar("Named")


class NetworkPlan(Struct, frozen=True, forbid_unknown_fields=True):
    """[networks.NAME]: a network, or descriptors that were made elsewhere.

    model: "grid" or "fc6"; a file or folder of `lookback model import`; or any other ONNX file that makes a descriptor
    of an RGB image. size: height and width of its images, where the file leaves them open; mean, std: of RGB images
    from 0 to 1. descriptors: a .npy file for each traverse, (n, D) or (n, R, D) of R regions, a row for each frame that
    the sampling chooses.
    """

    model: str = ""
    size: tuple[Pixels, Pixels] | None = None
    mean: tuple[float, float, float] = (0.485, 0.456, 0.406)
    std: tuple[Positive, Positive, Positive] = (0.229, 0.224, 0.225)
    descriptors: dict[str, str] = {}


class TraversePlan(Struct, frozen=True, forbid_unknown_fields=True):
    """[traverses.NAME]: a recording, several (each a drive of its own), or a scenario that is rendered into a feed.

    A scenario has a frame every spacing of the sampling.
    last_row: the last row of the feed that is used. seed: the road of the scenario, instead of its own.
    """

    feed: str = ""
    feeds: tuple[str, ...] = ()
    scenario: str = ""
    seed: Seed | None = None
    last_row: Annotated[int, Meta(ge=0)] | None = None


class Pair(Struct, frozen=True, forbid_unknown_fields=True):
    """[[pairs]]: a query traverse against a reference one, and what counts as the same place.

    truth: positions (latitude and longitude of both feeds, or else columns local_x_m and local_y_m, meters);
    route_m (a column of both, meters along one route); rows (equal source_frame, or else equal row, frames; of
    traverses with several feeds, equally numbered feeds); anchors (frames). Or a .npy file: a matrix (queries,
    places) of what is right, or the list of places of each query that VPR-Bench has. soft: a matrix of what is
    neither right nor wrong, as GTsoft of VPR_Tutorial: these places are masked, and the next best answer counts.
    similarity: by the name of a method, the .npy file of its similarities (queries, places), higher is more alike.
    transposed: all these matrices are (places, queries), as in VPR_Tutorial.
    ahead: how far ahead of the vehicle, in its direction of travel, the right place lies, meters or frames: the offset
    of the rig, as `lookback calibrate` prints it. calibration: a traverse on which each method measures it instead.
    anchors: [row of the query, row of the reference] in the order of the query, interpolated between; queries outside
    have no truth. loop: rows of the reference after which it is at its first place again, 0 where it is no loop;
    anchors then count on from lap to lap. loops: the same for feeds of the reference, by name, with truth = "rows".
    directions: in which lines are searched. kind: pairs of one kind are one column of the means (default: its name).
    figure: of the paper.
    """

    name: str
    reference: str
    query: str
    truth: str = "positions"
    soft: str = ""
    similarity: dict[str, str] = {}
    transposed: bool = False
    tolerance: Positive = 40.0
    ahead: float = 0.0
    calibration: str = ""
    length: Length | None = None
    length_m: Positive | None = None
    directions: Literal["both", "forward", "reverse"] = "both"
    anchors: list[tuple[float, float]] = []
    loop: Annotated[int, Meta(ge=0)] = 0
    loops: dict[str, Annotated[int, Meta(ge=2)]] = {}
    kind: str = ""
    figure: str = ""


class Plan(Struct, frozen=True, forbid_unknown_fields=True):
    """The whole plan.

    seeds: roads on which every scenario is driven instead of its own, and every pair is compared.
    """

    title: str
    methods: Annotated[list[str], Meta(min_length=1)]
    traverses: dict[str, TraversePlan]
    pairs: Annotated[list[Pair], Meta(min_length=1)]
    networks: Annotated[dict[str, NetworkPlan], Meta(min_length=1)] = msgspec.field(
        default_factory=lambda: {"grid": NetworkPlan(model="grid")}
    )
    seeds: tuple[Seed, ...] = ()
    sampling: SamplingConfig = SamplingConfig()
    region_width: Annotated[float, Meta(ge=0.1, le=1.0)] = 0.4
    resamples: Annotated[int, Meta(ge=10, le=100000)] = 1000
    notes: str = ""


def load_plan(path: Path) -> Plan:
    """Read and check a plan; ConfigError names the file and the key, in one line."""
    plan = read_toml(path, Plan)
    _check_names(path, plan)
    return on_each_road(plan) if plan.seeds else plan


def on_each_road(plan: Plan) -> Plan:
    """The plan with a traverse and a pair for each of its seeds in place of each."""
    traverses = {
        f"{name}, road {seed}": replace(one, seed=seed) for seed in plan.seeds for name, one in plan.traverses.items()
    }
    pairs = []
    for seed, pair in product(plan.seeds, plan.pairs):
        ends = {key: f"{getattr(pair, key)}, road {seed}" for key in ("reference", "query")}
        pairs.append(replace(pair, **ends, name=f"{pair.name}, road {seed}", kind=pair.kind or pair.name))
    return replace(plan, traverses=traverses, pairs=pairs)


def checked_plan(where: Path, values: dict[str, Any]) -> Plan:
    """A plan that is no file; ConfigError names the key."""
    plan = convert_toml(values, where, Plan)
    _check_names(where, plan)
    return plan


def _check_names(path: Path, plan: Plan) -> None:
    """ConfigError unless all names in the plan are defined."""
    for name, network in plan.networks.items():
        if bool(network.model) == bool(network.descriptors):
            raise ConfigError(f"{path}: networks.{name}: needs model or descriptors, and not both")
    for name, traverse in plan.traverses.items():
        if plan.seeds and not traverse.scenario:
            raise ConfigError(f"{path}: seeds: need a scenario for every traverse; {name} has none")
        if [bool(traverse.feed), bool(traverse.feeds), bool(traverse.scenario)].count(True) != 1:
            raise ConfigError(f"{path}: traverses.{name}: needs one of feed, feeds and scenario")
        if traverse.feeds and traverse.last_row is not None:
            raise ConfigError(f"{path}: traverses.{name}: last_row needs feed, not feeds")
    for index, pair in enumerate(plan.pairs):
        _check_pair(f"{path}: pairs[{index}] {pair.name!r}", plan, pair)
    if plan.seeds and any(pair.calibration for pair in plan.pairs):
        raise ConfigError(f"{path}: seeds: not with calibration")


def _check_pair(where: str, plan: Plan, pair: Pair) -> None:
    """ConfigError unless the keys of a pair fit each other."""
    for key in ("reference", "query", "calibration"):
        name = getattr(pair, key)
        if name or key in ("reference", "query"):
            named(f"{where}: {key}", name, plan.traverses)
    if pair.calibration and (pair.calibration == pair.query or pair.ahead or pair.truth == "anchors"):
        raise ConfigError(f"{where}: calibration needs another drive than the query, no ahead, and no anchors")
    if pair.truth not in TRUTHS and not pair.truth.endswith(".npy"):
        raise ConfigError(f"{where}: truth: {pair.truth!r} is none of {', '.join(TRUTHS)}, and no .npy file")
    if pair.soft and pair.truth in TRUTHS:
        raise ConfigError(f"{where}: soft needs the .npy file of what is right as truth")
    if (pair.length is None) == (pair.length_m is None):
        raise ConfigError(f"{where}: needs length (frames) or length_m, and not both")
    if pair.length_m is not None and plan.sampling.by != "distance":
        raise ConfigError(f'{where}: length_m needs [sampling] by = "distance"; give length, in frames')
    rows = [query for query, _ in pair.anchors]
    if (pair.truth == "anchors") != (len(rows) >= 2) or rows != sorted(set(rows)):
        raise ConfigError(f'{where}: truth = "anchors" needs two or more anchors, the query\'s rows in order')


def named(where: str, name: str, known: dict[str, Named]) -> Named:
    """The one of that name; ConfigError lists the names there are."""
    if name not in known:
        raise ConfigError(f"{where}: no {name!r}; there are {', '.join(known)}")
    return known[name]
