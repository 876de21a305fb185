"""Raw descriptors of every traverse, each described once in a run and kept in memory."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from edge.descriptor.network import Network, Regions, pictures_for, region_count
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
        out = np.empty(
            (len(traverse.rows), region_count(network.info, regions), network.info.dimensions), dtype=np.float32
        )
        images, width = open_pictures(traverse.feed), self._plan.region_width
        title = f"{traverse.name}: {network.info.output} {network.info.precision}, {regions}"
        try:
            for target, row in zip(out, tqdm(traverse.rows, desc=title, unit="frame", leave=False), strict=True):
                target[:] = network.describe(pictures_for(network.info, images.read(row), regions, width))
        except FrameError as error:
            raise ConfigError(f"traverses.{traverse.name}: {error}") from None
        finally:
            images.close()
        return out

    def forget(self, name: str) -> None:
        """Release the descriptors of a network."""
        self._raw = {key: raw for key, raw in self._raw.items() if key[0] != name}
