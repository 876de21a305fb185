"""Raw descriptors of every traverse, each described once in a run and kept in memory; or read from files."""

from __future__ import annotations

from pathlib import Path
from time import process_time

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from edge.descriptor.network import Network, Regions, pictures_for, region_count
from edge.errors import ConfigError, FrameError
from edge.recognition.recognizer import model_key
from edge.reference_map import ModelKey
from sim.compare.networks import open_network
from sim.compare.plan import Plan
from sim.compare.traverses import MethodTraverse, open_pictures
from sim.compare.truth import read_array

Raw = NDArray[np.float32]
MATRIX = 2


class Descriptions:
    """Describes traverses with the networks of a plan; paths of models are relative to `folder`, others to `data`."""

    def __init__(self, plan: Plan, folder: Path, data: Path) -> None:
        self._plan = plan
        self._folder = folder
        self._data = data
        self._opened: dict[str, Network] = {}
        self._raw: dict[tuple[object, ...], tuple[NDArray[np.intp], Raw, float]] = {}

    def network(self, name: str) -> Network:
        """A network, opened once."""
        if name not in self._opened:
            self._opened[name] = open_network(name, self._plan.networks[name], self._folder)
        return self._opened[name]

    def opened(self) -> dict[str, Network]:
        """Every network that was used, by its name in the plan."""
        return dict(self._opened)

    def model_key(self, name: str, dimensions: int) -> ModelKey:
        """What a map keeps of a network, or of descriptors (n, R, dimensions) that were made elsewhere."""
        if self._plan.networks[name].descriptors:
            return ModelKey(name, "0" * 64, "file", dimensions)
        return model_key(self.network(name))

    def raw(self, traverse: MethodTraverse, name: str, regions: Regions) -> Raw:
        """Descriptors (n, R, D) float32 of a traverse as the network gives them."""
        return self._made(traverse, name, regions)[0]

    def frame_ms(self, traverse: MethodTraverse, name: str, regions: Regions) -> float:
        """Milliseconds that a frame's description took, without reading its picture; NaN of files."""
        return self._made(traverse, name, regions)[1]

    def _made(self, traverse: MethodTraverse, name: str, regions: Regions) -> tuple[Raw, float]:
        if self._plan.networks[name].descriptors:
            return self._read(traverse, name)
        network = self.network(name)
        key = (name, network.info.sha256, regions, traverse.paths)
        # A traverse that ends earlier has the rows of the whole one.
        if key not in self._raw or not np.isin(traverse.rows, self._raw[key][0]).all():
            self._raw[key] = (traverse.rows, *self._described(traverse, network, regions))
        rows, raw, frame_ms = self._raw[key]
        return raw[np.searchsorted(rows, traverse.rows)], frame_ms

    def _read(self, traverse: MethodTraverse, name: str) -> tuple[Raw, float]:
        """Descriptors of a traverse that were made elsewhere. ConfigError names what is missing."""
        files = self._plan.networks[name].descriptors
        if traverse.name not in files:
            raise ConfigError(f"[networks.{name}]: descriptors: none of the traverse {traverse.name!r}")
        path = self._data / files[traverse.name]
        raw = read_array(path)
        raw = raw[:, np.newaxis] if raw.ndim == MATRIX else raw
        count = len(traverse.rows)
        if raw.dtype.kind != "f" or raw.ndim != MATRIX + 1 or len(raw) != count or not np.isfinite(raw).all():
            raise ConfigError(
                f"{path}: {raw.dtype} {raw.shape}; needs finite numbers, a row for each of the {count} frames of"
                f" {traverse.name}: ({count}, dimensions) or ({count}, regions, dimensions)"
            )
        return raw.astype(np.float32), float("nan")

    def _described(self, traverse: MethodTraverse, network: Network, regions: Regions) -> tuple[Raw, float]:
        """ConfigError names a picture that cannot be read."""
        shape = (len(traverse.rows), region_count(network.info, regions), network.info.dimensions)
        out, took_s = np.empty(shape, dtype=np.float32), 0.0
        images, width = open_pictures(traverse.feed), self._plan.region_width
        title = f"{traverse.name}: {network.info.output} {network.info.precision}, {regions}"
        try:
            for target, row in zip(out, tqdm(traverse.rows, desc=title, unit="frame", leave=False), strict=True):
                image, began_s = images.read(row), process_time()
                target[:] = network.describe(pictures_for(network.info, image, regions, width))
                took_s += process_time() - began_s
        except FrameError as error:
            raise ConfigError(f"traverses.{traverse.name}: {error}") from None
        finally:
            images.close()
        return out, 1e3 * took_s / len(out)
