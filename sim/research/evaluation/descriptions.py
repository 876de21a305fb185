"""Raw descriptors of every traverse, each described once in a run and kept in memory."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from edge.descriptor.network import REGION_COUNT, Network, Regions, cut_regions
from edge.errors import ConfigError, FrameError
from sim.research.evaluation.networks import Tap, open_network
from sim.research.evaluation.plan import Plan
from sim.research.evaluation.traverses import Traverse, open_pictures

Raw = NDArray[np.float32]


class Descriptions:
    """Describes traverses with the networks of a plan; paths of models are relative to `folder`."""

    def __init__(self, plan: Plan, folder: Path) -> None:
        self._plan = plan
        self._folder = folder
        self._opened: dict[str, Network] = {}
        self._raw: dict[tuple[object, ...], Raw] = {}

    def network(self, name: str, tap: Tap) -> Network:
        """A layer of a network, opened once."""
        network = open_network(name, self._plan.networks[name], self._folder, tap)
        self._opened[network.info.sha256] = network
        return network

    def opened(self) -> list[Network]:
        """Every network that was used."""
        return list(self._opened.values())

    def raw(self, traverse: Traverse, name: str, tap: Tap, regions: Regions) -> Raw:
        """Descriptors (n, R, D) float32 of a traverse as the layer gives them."""
        network = self.network(name, tap)
        key = (name, network.info.sha256, regions, traverse.paths, traverse.rows.tobytes())
        if key not in self._raw:
            self._raw[key] = self._described(traverse, network, regions)
        return self._raw[key]

    def _described(self, traverse: Traverse, network: Network, regions: Regions) -> Raw:
        """ConfigError names a picture that cannot be read."""
        out = np.empty((len(traverse.rows), REGION_COUNT[regions], network.info.dimensions), dtype=np.float32)
        images, width = open_pictures(traverse.feed), self._plan.region_width
        title = f"{traverse.name}: {network.info.output} {network.info.precision}, {regions}"
        try:
            for target, row in zip(out, tqdm(traverse.rows, desc=title, unit="frame", leave=False), strict=True):
                target[:] = network.describe(cut_regions(images.read(row), regions, width, network.size))
        except FrameError as error:
            raise ConfigError(f"traverses.{traverse.name}: {error}") from None
        finally:
            images.close()
        return out

    def forget(self, name: str) -> None:
        """Release the descriptors of a network."""
        self._raw = {key: raw for key, raw in self._raw.items() if key[0] != name}

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
