"""A folder of VPR-Bench (https://github.com/MubarizZaffar/VPR-Bench): costs of its pictures, and its ground truth.

    ref/0000000.jpg ...   query/0000000.jpg ...   ground_truth_new.npy

The ground truth is a pickled array of rows [query, [right references]], numbers in the order of the names. Its pickle
may name nothing but arrays and numbers, since a pickle can run any program.
"""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from edge.config import DescriptorConfig
from edge.descriptor.network import Network, cut_regions
from edge.descriptor.open_network import normalized_set
from edge.errors import ConfigError, FrameError
from edge.feed import read_picture
from sim.datasets.pictures import list_pictures
from sim.research.evaluation.matching import unit_rows

GROUND_TRUTH = "ground_truth_new.npy"
NUMPY = ("numpy.core.multiarray", "numpy._core.multiarray")  # before and since NumPy 2
ALLOWED = {("numpy", "ndarray"), ("numpy", "dtype"), ("_codecs", "encode"), *product(NUMPY, ("_reconstruct", "scalar"))}
"""What a pickle of arrays and numbers names."""


def costs(folder: Path) -> NDArray[np.float64]:
    """Cosine distances (reference x query) of the shipped network's descriptors, each set normalized over the whole."""
    network = Network.load()
    references, queries = (unit_rows(_described(folder / name, network)) for name in ("ref", "query"))
    return 1.0 - (references @ queries.T).astype(np.float64)


def truth(file: Path, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Which reference is right for which query, of that shape (reference x query). ConfigError names the file."""
    out = np.zeros(shape, dtype=bool)
    try:
        for query, references in _rows(file):
            out[np.atleast_1d(references).astype(np.intp), int(query)] = True
    except OSError as error:
        raise ConfigError(f"{file}: cannot read it: {error.strerror}") from None
    except (pickle.UnpicklingError, ValueError, TypeError, EOFError, AttributeError) as error:
        raise ConfigError(f"{file}: not rows [query, [references]] as VPR-Bench has them: {error}") from None
    except IndexError:
        raise ConfigError(f"{file}: names pictures beyond the {shape[0]} references and {shape[1]} queries") from None
    return out


def _rows(file: Path) -> Iterator[tuple[Any, Any]]:
    with file.open("rb") as stream:
        version = np.lib.format.read_magic(stream)
        read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        read_header(stream)
        array = _Arrays(stream, encoding="latin1").load()
    yield from ((row[0], row[1]) for row in array)


class _Arrays(pickle.Unpickler):
    """Loads arrays, lists and numbers; UnpicklingError for all else."""

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in ALLOWED:
            raise pickle.UnpicklingError(f"{module}.{name} in it is neither an array nor a number")
        return super().find_class(module, name)


def _described(folder: Path, network: Network) -> NDArray[np.float32]:
    config = DescriptorConfig()
    files = [folder / name for name in list_pictures(folder)]
    try:
        raw = np.stack([
            network.describe(cut_regions(read_picture(file), config.regions, config.region_width, network.size))
            for file in tqdm(files, desc=folder.name, unit="picture")
        ])  # fmt: skip
    except FrameError as error:
        raise ConfigError(str(error)) from None
    return normalized_set(raw)
