"""Raw descriptors of every traverse, each described once in a run and kept in memory."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from edge.camera.feed import FeedImages
from edge.descriptor.network import Head, Network
from edge.descriptor.regions import REGION_COUNT, Regions, cut_regions
from edge.descriptor.weights import Weights
from edge.errors import ConfigError, FrameError
from sim.evaluation.networks import Precision, Tap, open_head, open_network, read_plan_weights
from sim.evaluation.plan import Plan
from sim.evaluation.segments import likeliest_states, runs
from sim.evaluation.traverses import Traverse

Raw = NDArray[np.float32]


class Descriptions:
    """Describes traverses with the networks of a plan; paths of models are relative to `folder`."""

    def __init__(self, plan: Plan, folder: Path) -> None:
        self._plan = plan
        self._folder = folder
        self._networks: dict[tuple[str, Tap, Precision | None], Network] = {}
        self._raw: dict[tuple[object, ...], Raw] = {}

    def network(self, name: str, tap: Tap, precision: Precision | None = None) -> Network:
        """A layer of a network, opened once."""
        key = (name, tap, precision)
        if key not in self._networks:
            self._networks[key] = open_network(name, self._plan.networks[name], self._folder, tap, precision)
        return self._networks[key]

    def head(self, name: str) -> Head:
        """The categories of a network's fc6."""
        return open_head(name, self._plan.networks[name], self._folder, self.network(name, "fc6"))

    def weights(self, name: str) -> Weights:
        """Float weights of a network; ConfigError if the plan gives none."""
        return read_plan_weights(name, self._plan.networks[name], self._folder)

    def opened(self) -> list[Network]:
        """Every network that was used so far."""
        return list(self._networks.values())

    def raw(self, traverse: Traverse, name: str, tap: Tap, regions: Regions, precision: Precision | None = None) -> Raw:
        """Descriptors (n, R, D) float32 of a traverse as the layer gives them."""
        key = (traverse.name, traverse.sampling, name, tap, regions, precision)
        if key not in self._raw:
            network = self.network(name, tap, precision)
            self._raw[key] = _describe(traverse, network, regions, self._plan.region_width)
        return self._raw[key]

    def external(self, traverse: Traverse, name: str) -> Raw:
        """Descriptors (n, 1, D) that another program made of a whole feed; ConfigError names the file."""
        where = f"traverses.{traverse.name}: external.{name}"
        if name not in traverse.external:
            raise ConfigError(f"{where}: not given, and a method asks for it")
        path = self._folder / traverse.external[name]
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
    """A .npy of finite numbers; ConfigError names the file. Mapped, so that a header cannot claim memory."""
    try:
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except OSError as error:
        raise ConfigError(f"{path}: cannot read it: {error.strerror or error}") from None
    except (ValueError, EOFError) as error:
        raise ConfigError(f"{path}: not a whole .npy file of numbers: {error}") from None
    if array.ndim != dimensions or array.dtype.kind not in "fiu" or not array.size:
        raise ConfigError(
            f"{path}: holds {array.dtype} of shape {array.shape}; needs numbers in {dimensions} dimensions"
        )
    out = np.asarray(array, dtype=np.float64)
    if not np.isfinite(out).all():
        raise ConfigError(f"{path}: has values that are not finite")
    return out


def _describe(traverse: Traverse, network: Network, regions: Regions, width: float) -> Raw:
    out = np.empty((len(traverse.rows), REGION_COUNT[regions], network.info.dimensions), dtype=np.float32)
    images = FeedImages(traverse.feed)
    title = f"{traverse.name}: {network.info.tap} {network.info.precision}, {regions}"
    try:
        for target, row in zip(out, tqdm(traverse.rows, desc=title, unit="frame", leave=False), strict=True):
            target[:] = network.describe(cut_regions(images.read(int(row)), regions, width))
    except FrameError as error:
        raise ConfigError(f"traverses.{traverse.name}: {error}") from None
    finally:
        images.close()
    return out
