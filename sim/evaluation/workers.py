"""Describing whole traverses, one a task: here, in processes of this machine, or on a Dask cluster.

Wherever it runs it is the same function with the same network file, so the numbers are the same.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from edge.descriptor.regions import REGION_COUNT, Regions, cut_regions
from edge.errors import ConfigError, FrameError
from edge.feed import FeedImages, read_feed
from sim.evaluation.networks import Precision, Tap, open_network
from sim.evaluation.plan import NetworkPlan

CONNECT_TIMEOUT_S = 10


@dataclass(frozen=True)
class DescribeTask:
    """Chosen rows of a feed, and the layer that describes them; paths are those of the machine that runs it."""

    traverse: str
    feed: Path
    rows: tuple[int, ...]
    network: str
    network_plan: NetworkPlan
    models: Path
    tap: Tap
    precision: Precision | None
    regions: Regions
    region_width: float


def describe(task: DescribeTask, progress: bool = False) -> NDArray[np.float32]:
    """Raw descriptors (n, R, D) float32; ConfigError names a picture that cannot be read."""
    network = open_network(task.network, task.network_plan, task.models, task.tap, task.precision)
    out = np.empty((len(task.rows), REGION_COUNT[task.regions], network.info.dimensions), dtype=np.float32)
    images = FeedImages(read_feed(task.feed))
    title = f"{task.traverse}: {task.tap} {network.info.precision}, {task.regions}"
    try:
        for target, row in zip(
            out, tqdm(task.rows, desc=title, unit="frame", leave=False, disable=not progress), strict=True
        ):
            target[:] = network.describe(cut_regions(images.read(row), task.regions, task.region_width))
    except FrameError as error:
        raise ConfigError(f"traverses.{task.traverse}: {error}") from None
    finally:
        images.close()
    return out


@contextmanager
def open_executor(workers: int, cluster: str) -> Iterator[Executor | None]:
    """Where tasks run: `cluster` is the address of a Dask scheduler, else `workers` processes; None is in-process.

    ConfigError if Dask is not installed or does not answer.
    """
    if cluster:
        try:
            dask = import_module("dask.distributed")
        except ImportError:
            raise ConfigError("--cluster: needs Dask; pip install 'lookback[cluster]'") from None
        try:
            client = dask.Client(cluster, timeout=CONNECT_TIMEOUT_S)
        except (OSError, ValueError) as error:
            raise ConfigError(f"--cluster: {cluster} does not answer: {str(error).splitlines()[0]}") from None
        with client:
            yield client.get_executor()
    elif workers > 1:
        # Spawned, not forked: ONNX Runtime has threads.
        with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
            yield pool
    else:
        yield None
