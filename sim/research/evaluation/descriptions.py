"""Raw descriptors of every traverse, each described once in a run and kept in memory."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from edge.descriptor.network import REGION_COUNT, Head, Network, Regions, cut_regions
from edge.errors import ConfigError, FrameError
from sim.research.evaluation.methods import likeliest_states, runs
from sim.research.evaluation.networks import Precision, Tap, open_head, open_network
from sim.research.evaluation.plan import NetworkPlan, Plan
from sim.research.evaluation.traverses import Traverse, open_pictures, read_feeds

Raw = NDArray[np.float32]


class Descriptions:
    """Describes traverses with the networks of a plan; paths of models are relative to `folder`."""

    def __init__(self, plan: Plan, folder: Path) -> None:
        self._plan = plan
        self._folder = folder
        self._opened: dict[str, Network] = {}
        self._raw: dict[DescribeTask, Raw] = {}

    def network(self, name: str, tap: Tap, precision: Precision | None = None) -> Network:
        """A layer of a network, opened once."""
        network = open_network(name, self._plan.networks[name], self._folder, tap, precision)
        self._opened[network.info.sha256] = network
        return network

    def head(self, name: str) -> Head:
        """The categories of a network's fc6."""
        return open_head(name, self._plan.networks[name], self._folder, self.network(name, "fc6"))

    def opened(self) -> list[Network]:
        """Every network that was used."""
        return list(self._opened.values())

    def task(
        self, traverse: Traverse, name: str, tap: Tap, regions: Regions, precision: Precision | None = None
    ) -> DescribeTask:
        """The task that describes a traverse."""
        rows = tuple(traverse.rows.tolist())
        plan, width = self._plan.networks[name], self._plan.region_width
        paths = traverse.paths
        return DescribeTask(traverse.name, paths, rows, name, plan, self._folder, tap, precision, regions, width)

    def raw(self, traverse: Traverse, name: str, tap: Tap, regions: Regions, precision: Precision | None = None) -> Raw:
        """Descriptors (n, R, D) float32 of a traverse as the layer gives them."""
        self.network(name, tap, precision)
        task = self.task(traverse, name, tap, regions, precision)
        if task not in self._raw:
            self._raw[task] = describe(task, progress=True)
        return self._raw[task]

    def forget(self, name: str) -> None:
        """Release the descriptors of a network."""
        self._raw = {task: raw for task, raw in self._raw.items() if task.network != name}

    def external(self, traverse: Traverse, name: str) -> Raw:
        """Descriptors (n, 1, D) that another program made of a whole feed; ConfigError names the file."""
        where = f"traverses.{traverse.name}: external.{name}"
        if name not in traverse.external:
            raise ConfigError(f"{where}: not given, and a method asks for it")
        path = traverse.external[name]
        given = read_matrix(path)
        if len(given) != len(traverse.feed.rows):
            raise ConfigError(f"{where}: {path} has {len(given)} rows, its feed has {len(traverse.feed.rows)}")
        return given[traverse.rows][:, np.newaxis].astype(np.float32)

    def probabilities(self, traverse: Traverse, name: str) -> NDArray[np.float32]:
        """Place categories of whole images, (n, C)."""
        return self.head(name).probabilities(self.raw(traverse, name, "fc6", "whole")[:, 0])

    def segments(self, traverse: Traverse, name: str) -> list[tuple[int, int]]:
        """[start, end) of each stretch of one kind of place (section VI-B)."""
        return runs(likeliest_states(self.probabilities(traverse, name)))


def read_matrix(path: Path, dimensions: int = 2) -> NDArray[np.float64]:
    """A .npy of finite numbers; ConfigError names the file. Memory-mapped, so that a header cannot claim memory."""
    try:
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except OSError as error:
        raise ConfigError(f"{path}: cannot read it: {error.strerror or error}") from None
    except (ValueError, EOFError) as error:
        raise ConfigError(f"{path}: not a whole .npy file of numbers: {error}") from None
    if array.ndim != dimensions or array.dtype.kind not in "fiu" or not array.size:
        shape = array.shape
        raise ConfigError(f"{path}: holds {array.dtype} of shape {shape}; needs numbers in {dimensions} dimensions")
    out = np.asarray(array, dtype=np.float64)
    if not np.isfinite(out).all():
        raise ConfigError(f"{path}: has values that are not finite")
    return out


@dataclass(frozen=True)
class DescribeTask:
    """Chosen rows of a traverse, and the layer that describes them; paths are those of the machine that runs it."""

    traverse: str
    feeds: tuple[Path, ...]
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
    images = open_pictures(read_feeds(task.feeds))
    title = f"{task.traverse}: {task.tap} {network.info.precision}, {task.regions}"
    try:
        for target, row in zip(
            out, tqdm(task.rows, desc=title, unit="frame", leave=False, disable=not progress), strict=True
        ):
            target[:] = network.describe(cut_regions(images.read(row), task.regions, task.region_width, network.size))
    except FrameError as error:
        raise ConfigError(f"traverses.{task.traverse}: {error}") from None
    finally:
        images.close()
    return out
