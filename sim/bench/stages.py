"""One function at a time: networks, keypoints, motion, matching, search."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import count
from pathlib import Path

import cv2
import faiss
import numpy as np
import onnx
from numpy.typing import NDArray

from edge.config import CameraConfig, Config
from edge.descriptor.model_file import GRID, XFEAT, resolve_model
from edge.descriptor.network import IMAGE, Network, cut_regions, open_session, pictures_for
from edge.keypoints.network import KeypointNetwork
from edge.reference_map.costs import CostMatcher, encode, inverse_lengths, squared_norms
from edge.sequence import VIEWS_OPPOSED
from edge.sequence.search import NO_LINE, SequenceCosts, SequenceSearch, slopes_around_diagonal
from edge_plugins.motion import MotionConfig
from edge_plugins.motion.camera_motion import CameraMotion
from sim.bench.frames import SIZE_PX, smooth_picture
from sim.bench.table import Row, Run, raced
from sim.evaluation.matched_points import verify

faiss.omp_set_num_threads(1)
VGA = f"{SIZE_PX[0]}x{SIZE_PX[1]}"
SIZES = (SIZE_PX, (1920, 1080))
DIMENSIONS = 4096
LENGTH, SLOPES = 40, slopes_around_diagonal(0.2, 21)
FOV_DEG, STEP_M, STEP_NS, HIGH_M, TEXEL_M, PICTURES = 80.0, 0.7, 100_000_000, 1.4, 0.05, 24
MOTION = Config(camera=CameraConfig(fov_deg=FOV_DEG), plugins={"motion": MotionConfig(use="report")})
CORNERS = 400
"""Points that a rival follows or finds: as many as there are keypoints."""


def measure(rounds: int, places: Sequence[int]) -> Iterator[Row]:
    """places: of the maps that are matched and searched."""
    yield from networks(rounds)
    yield from keypoints(rounds)
    yield motion(rounds)
    for number in places:
        yield matching(number, rounds)
    for number in places:
        yield search(number, rounds)


def networks(rounds: int) -> Iterator[Row]:
    """Both networks, and what cuts a picture into their regions."""
    for width, height in SIZES:
        picture = smooth_picture(np.random.default_rng(0), (width, height))
        cut = partial(cut_regions, picture, "left-right", 0.4, (224, 224))
        area = ("OpenCV, INTER_AREA", partial(_by_area, picture))
        yield raced("regions cut and resized", f"{width}x{height}", rounds, cut, rival=area)
    picture = smooth_picture(np.random.default_rng(0), SIZE_PX)
    grid, fc6 = Network.load(Path("grid")), Network.load()
    whole, halves = (pictures_for(one.info, picture, "left-right", 0.4) for one in (grid, fc6))
    other = cv2.dnn.readNetFromONNX(str(GRID))
    opencv = ("OpenCV, the same file", partial(_through, other, whole))
    ours = partial(grid.describe, whole)
    yield raced("network grid, float32", VGA, rounds, ours, floor=floor_of(GRID, whole.shape), rival=opencv)
    ours, floor = partial(fc6.describe, halves), floor_of(resolve_model(None), halves.shape)
    yield raced("network fc6, int8", VGA, rounds, ours, floor=floor, most=1.25)


def keypoints(rounds: int) -> Iterator[Row]:
    """The points of one picture, and two pictures compared by them."""
    network = KeypointNetwork()
    one, other = (smooth_picture(np.random.default_rng(seed), SIZE_PX) for seed in (0, 1))
    here, near, elsewhere = (network.extract(image) for image in (one, np.roll(one, 12, axis=1), other))
    sift = cv2.SIFT.create(nfeatures=CORNERS)
    floor, rival = floor_of(XFEAT, (1, 224, 320, 3)), ("OpenCV, SIFT", lambda: sift.detectAndCompute(one, None))
    yield raced("keypoints of one picture", VGA, rounds, lambda: network.extract(one), floor=floor, rival=rival)
    matcher = cv2.BFMatcher(cv2.NORM_L2, crossCheck=True)
    rows = [points.descriptors.astype(np.float32) for points in (here, near)]
    alone = ("OpenCV, its matcher without geometry", lambda: matcher.match(*rows))
    yield raced("two pictures compared", "the same place", rounds, lambda: verify(here, near), rival=alone)
    yield raced("two pictures compared", "two places", rounds, lambda: verify(here, elsewhere))


def motion(rounds: int) -> Row:
    """Over a level road of random gray."""
    ours, number = CameraMotion(MOTION), count(1)
    pictures = [road(STEP_M * step) for step in range(PICTURES)]
    grays = [cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY) for picture in pictures[:2]]

    def one() -> None:
        at = next(number)
        ours.follow(pictures[at % PICTURES], at * STEP_NS, None)

    def followed() -> None:
        corners = cv2.goodFeaturesToTrack(grays[0], CORNERS, 0.01, 5)
        cv2.calcOpticalFlowPyrLK(grays[0], grays[1], corners, np.zeros_like(corners))

    rival = (f"OpenCV, {CORNERS} corners followed", followed)
    return raced("motion of one picture", VGA, 3 * rounds, one, rival=rival, most=1)


def road(at_m: float) -> NDArray[np.uint8]:
    """A level road of random gray, (H, W, 3) BGR, as seen after `at_m`."""
    width, high = SIZE_PX
    texture = cv2.GaussianBlur(np.random.default_rng(5).integers(0, 255, (800, 400), np.uint8), (0, 0), 1.0)
    focal_px = width / 2 / math.tan(math.radians(FOV_DEG) / 2)
    camera = np.array([[focal_px, 0, width / 2], [0, focal_px, high / 2], [0, 0, 1]])
    ground = np.array([[1, 0, 0], [0, 0, HIGH_M], [0, 1, 0]])
    meters = np.array([[TEXEL_M, 0, -10], [0, TEXEL_M, -at_m], [0, 0, 1]])
    gray = cv2.warpPerspective(texture, camera @ ground @ meters, (width, high), borderValue=128)
    gray[: high // 2] = 128
    return cv2.cvtColor(gray, cv2.COLOR_GRAY2BGR).astype(np.uint8, copy=False)


def matching(places: int, rounds: int, dimensions: int = DIMENSIONS) -> Row:
    """Both region orders of one frame against a whole map; faiss has the same numbers, in one order."""
    rng = np.random.default_rng(places)
    descriptors = encode(rng.standard_normal((places, 2, dimensions), np.float32))
    index = faiss.IndexScalarQuantizer(
        2 * dimensions, faiss.ScalarQuantizer.QT_8bit_direct_signed, faiss.METRIC_INNER_PRODUCT
    )
    norms_sq = []
    for start in range(0, places, 1000):
        block = descriptors[:, start : start + 1000]
        index.add(block.swapaxes(0, 1).reshape(block.shape[1], -1).astype(np.float32))
        norms_sq.append(squared_norms(block))
    matcher = CostMatcher(descriptors, inverse_lengths(np.concatenate(norms_sq)))
    query = rng.normal(size=(1, 2, dimensions)).astype(np.float32)
    flat, floor = query.reshape(1, -1), partial(read_all, descriptors)
    rival = ("faiss SQ8, one of the two orders", lambda: index.search(flat, 1))
    size = f"{places:,} places x {2 * dimensions}"
    return raced(
        "matching",
        size,
        rounds,
        lambda: matcher.costs(query),
        floor=floor,
        rival=rival,
        most=1.3,
    )


def search(places: int, rounds: int) -> Row:
    """Two lines of planes (directions with their region order), 21 slopes, as the daemon searches."""
    sums = np.zeros((len(SLOPES), 2, places), dtype=np.int32)
    rival, floor = ("eq. 2 as it stands, in NumPy", direct(places, LENGTH)), partial(np.add, sums, 1, out=sums)
    size, few = f"{places:,} places, {LENGTH} frames", max(2, rounds // 5)
    return raced("search", size, few, running(places, LENGTH), floor=floor, rival=rival)


def running(places: int, length: int) -> Callable[[], SequenceCosts | None]:
    """One frame of the daemon's search: a row in, and the best line that ends at each place."""
    found = SequenceSearch([(0, places)], VIEWS_OPPOSED, length, SLOPES)
    *before, newest = _rows(places, length)
    for row in before:
        found.push(row)

    def step() -> SequenceCosts | None:
        found.push(newest)
        return found.lines()

    return step


def direct(places: int, length: int) -> Run:
    """Equation 2 as it stands, vectorized over places: for each slope the L costs along each line, gathered, summed."""
    rows = _rows(places, length)
    at = np.arange(places)
    # Rounded as in the frame in which the running sums are full for the first time, so that the two can be compared.
    marks = [np.array([math.floor(slope * frame + 0.5) for frame in range(1, length + 1)]) for slope in SLOPES]

    def step() -> NDArray[np.int32]:
        best = np.full(places, NO_LINE, dtype=np.int32)
        for order, sign in ((1, 1), (0, -1)):
            for passed in marks:
                lines = at - sign * (passed[-1] - passed)[:, np.newaxis]
                inside = ((lines >= 0) & (lines < places)).all(axis=0)
                sums = rows[np.arange(length)[:, np.newaxis], order, lines.clip(0, places - 1)].sum(axis=0)
                np.minimum(best, np.where(inside, sums, NO_LINE), out=best)
        return best

    return step


def _rows(places: int, number: int) -> NDArray[np.int32]:
    return np.random.default_rng(places).integers(10_000, 20_000, (number, 2, places), dtype=np.int32)


def _by_area(picture: NDArray[np.uint8]) -> None:
    cut_px = round(0.4 * picture.shape[1])
    for part in (picture[:, :cut_px], picture[:, -cut_px:]):
        cv2.resize(part, (224, 224), interpolation=cv2.INTER_AREA)


def _through(network: cv2.dnn.Net, pictures: NDArray[np.uint8]) -> object:
    network.setInput(pictures)
    return network.forward()


def read_all(memory: NDArray[np.generic]) -> None:
    """Touch every byte once, at the speed of the memory: the cheapest reduction that NumPy has."""
    flat = memory.reshape(-1).view(np.uint8)
    np.bitwise_or.reduce(flat[: flat.size // 8 * 8].view(np.int64), axis=None)


def floor_of(file: Path, shape: tuple[int, ...]) -> Run:
    """Reads a network's file once, and multiplies as often as it does for images of that shape, in cache."""
    weights, macs = np.fromfile(file, np.uint8), products_of(onnx.load(file), shape)
    is_int8, multiplied = "int8" in file.name, 0.0
    sides = []
    while multiplied < macs:  # of several products of matrices that a cache holds
        sides.append(min(768, max(16, round((macs - multiplied) ** (1 / 3)))))
        multiplied += sides[-1] ** 3
    products = [product_of_matrices(side, is_int8=is_int8) for side in sides]

    def run() -> None:
        read_all(weights)
        for product in products:
            product()

    return run


def products_of(model: onnx.ModelProto, shape: tuple[int, ...]) -> float:
    """Multiply-accumulates of the convolutions and the full layers of a network, for images (B, H, W, 3)."""
    layers = [node for node in model.graph.node if node.op_type in ("Conv", "Gemm")]
    sizes = {one.name: tuple(one.dims) for one in model.graph.initializer}
    names = {name for node in layers for name in (node.input[1], node.output[0])} - sizes.keys()
    del model.graph.output[:]
    model.graph.output.extend(
        onnx.helper.make_tensor_value_info(n, onnx.TensorProto.FLOAT, None) for n in sorted(names)
    )
    found = open_session(model.SerializeToString()).run(sorted(names), {IMAGE: np.zeros(shape, np.uint8)})
    sizes |= {name: array.shape for name, array in zip(sorted(names), found, strict=True)}
    macs = 0.0
    for node in layers:
        weight, out = sizes[node.input[1]], sizes[node.output[0]]
        macs += math.prod(out) * math.prod(weight) / (weight[0] if node.op_type == "Conv" else weight[1])
    return macs


def product_of_matrices(side: int, *, is_int8: bool) -> Run:
    """side**3 products under ONNX Runtime, of numbers of the kind that the network has."""
    kind, result, operator = onnx.TensorProto.FLOAT, onnx.TensorProto.FLOAT, "MatMul"
    rng = np.random.default_rng(0)
    rows, columns = rng.random((2, side, side), np.float32)
    if is_int8:
        kind, result, operator = onnx.TensorProto.UINT8, onnx.TensorProto.INT32, "MatMulInteger"
        rows, columns = (120 * rows).astype(np.uint8), (120 * columns - 60).astype(np.int8)
    make, tensor = onnx.helper, onnx.helper.make_tensor_value_info
    graph = make.make_graph(
        [make.make_node(operator, [IMAGE, "weights"], ["product"])],
        "product",
        [tensor(IMAGE, kind, [side, side])],
        [tensor("product", result, [side, side])],
        [onnx.numpy_helper.from_array(columns, "weights")],
    )
    model = make.make_model(graph, opset_imports=[make.make_opsetid("", 17)], ir_version=8)
    session = open_session(model.SerializeToString())
    return lambda: session.run(None, {IMAGE: rows})
