"""The machine: how fast one core reads memory, and how fast it multiplies int8: the floor of every stage."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.descriptor.network import open_session
from sim.bench.machine import machine_name
from sim.bench.timing import race

SIDE = 768


@dataclass(frozen=True)
class Machine:
    """One core: bytes_per_ms of memory read; macs_per_ms of int8 in cache, as the network's kernels do them."""

    name: str
    bytes_per_ms: float
    macs_per_ms: float

    def floor_ms(self, read_bytes: float, macs: float = 0.0) -> float:
        """The least time in which one core reads these bytes once and does these multiply-accumulates."""
        return read_bytes / self.bytes_per_ms + macs / self.macs_per_ms


def read_all(memory: NDArray[np.int8]) -> None:
    """Touch every byte once, at the speed of the memory: the cheapest reduction that NumPy has."""
    np.bitwise_or.reduce(memory.reshape(-1)[: memory.size // 8 * 8].view(np.int64), axis=None)


def measure_machine(memory_bytes: int, rounds: int) -> Machine:
    """The best of some runs, with a block of memory that no cache holds, and a product of matrices that one does."""
    memory = np.ones(memory_bytes, dtype=np.int8)
    reading = race({"read": lambda: read_all(memory)}, rounds)["read"]
    # Not alternately with the reading, which would evict it from the cache.
    multiplying = race({"multiply": product_of_matrices(SIDE)}, 5 * rounds)["multiply"]
    return Machine(machine_name(), memory_bytes / reading.least_ms, SIDE**3 / multiplying.least_ms)


def product_of_matrices(side: int) -> Callable[[], object]:
    """uint8 times constant int8, side**3 products, under ONNX Runtime: what its int8 layers come down to."""
    import onnx
    from onnx import helper

    rng = np.random.default_rng(0)
    given = helper.make_tensor_value_info("given", onnx.TensorProto.UINT8, [side, side])
    product = helper.make_tensor_value_info("product", onnx.TensorProto.INT32, [side, side])
    weights = onnx.numpy_helper.from_array(rng.integers(-60, 60, (side, side), dtype=np.int8), "weights")
    node = helper.make_node("MatMulInteger", ["given", "weights"], ["product"])
    graph = helper.make_graph([node], "product", [given], [product], [weights])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    session = open_session(model.SerializeToString())
    rows = rng.integers(0, 120, (side, side), dtype=np.uint8)
    return lambda: session.run(None, {"given": rows})
