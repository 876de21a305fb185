"""int8 against fp32, of the same graph; and what cutting and resizing the regions costs beside it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from edge.descriptor.network import IMAGE, Network, cut_regions, open_session
from sim.bench.frames import SIZE_PX, smooth_picture
from sim.bench.timing import race
from sim.research.alexnet import CONVS, FC6, FC6_SHAPE, alexnet_info, build_float
from sim.research.bench.machine import product_of_matrices, read_all
from sim.research.bench.rows import Row, Section, Target, against, at_most

FC6_BYTES = FC6_SHAPE[0] * FC6_SHAPE[1]
OUTPUT_SIDES = (55, 27, 13, 13, 13)  # of the convolutions, at 224 x 224
MACS = sum(int(np.prod(conv.shape)) * side**2 for conv, side in zip(CONVS, OUTPUT_SIDES, strict=True)) + FC6_BYTES
FLOOR = "its floor"
SIZES = (SIZE_PX, (1280, 720), (1920, 1080))


def measure(rounds: int) -> Section:
    """Batches of one region and of two, which is what a frame is."""
    network = Network.load()
    session = open_session(float_graph())
    picture = smooth_picture(np.random.default_rng(0), SIZES[0])
    regions = cut_regions(picture, "left-right", 0.4, network.size)
    rows: list[Row] = []
    for batch in (1, 2):
        images = np.ascontiguousarray(regions[:batch])
        racers: dict[str, Callable[[], object]] = {
            "int8": lambda images=images: network.describe(images),  # type: ignore[misc]
            "fp32": lambda images=images: session.run(None, {IMAGE: images}),  # type: ignore[misc]
        }
        times = race(racers, rounds)
        floor = race({"int8": racers["int8"], "floor": floor_of(batch)}, rounds)
        over = floor["int8"].ratio(floor["floor"])
        rows += [
            against(f"network fp32, batch {batch}", "fp32", times, "int8"),
            Row(f"network int8, batch {batch}", floor["int8"], FLOOR, over),
            Row(f"{FLOOR}, batch {batch}", floor["floor"]),
        ]
    faster = 1 / times["int8"].ratio(times["fp32"])
    targets = [
        Target("int8 network against fp32, batch 2", "3.3x faster or more", f"{faster:.2f}x", faster >= 3.3),
        at_most("int8 network against its floor, batch 2", 1.25, over),
    ]
    for size in SIZES:
        picture = smooth_picture(np.random.default_rng(0), size)
        cut = partial(cut_regions, picture, "left-right", 0.4, network.size)
        cutting = race({"cut": cut}, rounds)["cut"]
        share = cutting.median_ms / times["int8"].median_ms
        rows.append(Row(f"regions cut and resized, {size[0]}x{size[1]}", cutting, "network int8, batch 2", share))
    return Section("Network", rows, targets)


def floor_of(batch: int) -> Callable[[], None]:
    """Reads as many bytes as fc6 has weights, and multiplies as often as the whole network does, in cache."""
    weights = np.ones(FC6_BYTES, dtype=np.int8)
    multiply = product_of_matrices(round(MACS ** (1 / 3)))

    def run() -> None:
        read_all(weights)
        for _ in range(batch):
            multiply()

    return run


def float_graph() -> bytes:
    """The network in float32 with random weights: how long a product takes does not depend on its numbers."""
    rng = np.random.default_rng(0)
    shapes: dict[str, tuple[int, ...]] = {conv.layer: conv.shape for conv in CONVS} | {FC6: FC6_SHAPE}
    weights = {}
    for layer, shape in shapes.items():
        scale = np.float32(2 / np.prod(shape[1:])) ** 0.5  # keeps activations in range: denormals would be slow
        weights[f"{layer}.weight"] = rng.standard_normal(shape, np.float32) * scale
        weights[f"{layer}.bias"] = rng.standard_normal(shape[0], np.float32) * np.float32(0.1)
    return bytes(build_float(weights, alexnet_info("random")).SerializeToString())
