"""Files of PyTorch: weights that `torch.save` wrote, read without PyTorch; and whole networks, by its own exporter.

A checkpoint is a pickle that names its numbers by keys, with the numbers behind it (until 2020) or beside it in a zip
archive. Only what a state dictionary needs is unpickled; anything else is refused, since a pickle can run programs.
"""

from __future__ import annotations

import io
import logging
import pickle
import tempfile
import warnings
import zipfile
from collections import OrderedDict
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.errors import ModelError
from edge.extras import install_command

MAX_BYTES = 2**30
_LEGACY_MAGIC = 0x1950A86A20F9469CFC6C
_TYPES = {
    "DoubleStorage": "<f8",
    "FloatStorage": "<f4",
    "HalfStorage": "<f2",
    "LongStorage": "<i8",
    "IntStorage": "<i4",
    "ShortStorage": "<i2",
    "CharStorage": "i1",
    "ByteStorage": "u1",
    "BoolStorage": "?",
}
_Arrays = Mapping[str, NDArray[Any]]


def read_state(path: Path, data: bytes) -> _Arrays:
    """Arrays by name, of a state dictionary or of a checkpoint that has one. ModelError names the file."""
    try:
        checkpoint = _read_zip(data) if zipfile.is_zipfile(io.BytesIO(data)) else _read_legacy(data)
        state = checkpoint.get("state_dict", checkpoint)
        arrays = {name: value for name, value in state.items() if isinstance(value, np.ndarray)}
        if not arrays:
            raise ValueError("no arrays in it")
    except (ValueError, KeyError, IndexError, AttributeError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise ModelError(f"{path}: not a PyTorch checkpoint of weights: {error}") from None
    except (pickle.UnpicklingError, NotImplementedError) as error:
        raise ModelError(f"{path}: not a PyTorch checkpoint of weights: {str(error).splitlines()[0]}") from None
    return arrays


class _StorageType:
    """Stands for the class of a storage, such as torch.FloatStorage."""

    def __init__(self, dtype: str) -> None:
        self.dtype = np.dtype(dtype)


class _Unpickler(pickle.Unpickler):
    """Unpickles dictionaries, numbers, texts and tensors."""

    def __init__(self, file: io.BytesIO, storage: Callable[[str, np.dtype[Any], int], NDArray[Any]]) -> None:
        super().__init__(file, encoding="latin1")  # of checkpoints that Python 2 wrote
        self._storage = storage

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) == ("collections", "OrderedDict"):
            return OrderedDict
        if (module, name) == ("torch._utils", "_rebuild_tensor_v2"):
            return _tensor
        if (module, name) == ("torch._utils", "_rebuild_parameter"):
            return lambda tensor, *_: tensor
        if module == "torch" and name in _TYPES:
            return _StorageType(_TYPES[name])
        raise pickle.UnpicklingError(f"it holds {module}.{name}, and not only weights")

    def persistent_load(self, pid: Any) -> NDArray[Any]:
        _, kind, key, _, count, *_ = pid
        return self._storage(str(key), kind.dtype, int(count))


def _tensor(
    storage: NDArray[Any], offset: int, size: tuple[int, ...], stride: tuple[int, ...], *_: Any
) -> NDArray[Any]:
    last = offset + sum((length - 1) * step for length, step in zip(size, stride, strict=True))
    if min((offset, *size, *stride), default=0) < 0 or (0 not in size and last >= len(storage)):
        raise ValueError("a tensor runs past its numbers")
    strides = [step * storage.itemsize for step in stride]
    return np.lib.stride_tricks.as_strided(storage[offset:], size, strides, writeable=False).copy()


def _read_zip(data: bytes) -> Any:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        if sum(member.file_size for member in archive.infolist()) > MAX_BYTES:
            raise ValueError(f"it unpacks to more than {MAX_BYTES} bytes")
        entry = next((name for name in archive.namelist() if name.endswith("data.pkl")), None)
        if entry is None or any(name.endswith("constants.pkl") for name in archive.namelist()):
            raise ValueError("it holds a network and not only weights")
        folder = entry.removesuffix("data.pkl")

        def storage(key: str, dtype: np.dtype[Any], count: int) -> NDArray[Any]:
            return np.frombuffer(archive.read(f"{folder}data/{key}"), dtype, count)

        return _Unpickler(io.BytesIO(archive.read(entry)), storage).load()


def _read_legacy(data: bytes) -> Any:
    """Five pickles (magic number, version, machine, state, keys of the storages), then the numbers of each storage."""
    file, storages = io.BytesIO(data), dict[str, NDArray[Any]]()

    def storage(key: str, dtype: np.dtype[Any], count: int) -> NDArray[Any]:
        if not 0 <= count * dtype.itemsize <= len(data):
            raise ValueError(f"it claims {count} numbers and is shorter")
        return storages.setdefault(key, np.zeros(count, dtype))

    def load() -> Any:
        return _Unpickler(file, storage).load()

    if load() != _LEGACY_MAGIC:
        raise ValueError("it begins otherwise")
    load(), load()
    begin = file.tell()
    load()  # only to learn which storages there are
    for key in load():
        count, known = int.from_bytes(file.read(8), "little"), storages[str(key)]
        storages[str(key)] = np.frombuffer(file.read(known.nbytes), known.dtype, count)
    file.seek(begin)
    return load()


def export_onnx(path: Path, size: tuple[int, int]) -> bytes:
    """A TorchScript file (.pt) or an exported program (.pt2) as an ONNX file. ModelError names the file.

    PyTorch runs what is in the file, so it must be one that you trust.
    """
    try:
        import torch
    except ImportError:
        raise ModelError(f"{path}: needs PyTorch to be read: {install_command('torch')}") from None
    if not zipfile.is_zipfile(path):
        raise ModelError(f"{path}: not a whole file of TorchScript or torch.export")
    image = torch.zeros(2, 3, *size)
    logging.disable(logging.WARNING)  # its exporters report each of their steps
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        file = Path(folder) / "network.onnx"
        try:
            if path.suffix == ".pt2":
                torch.onnx.export(torch.export.load(path), f=file, external_data=False, verbose=False)
            else:
                network = torch.jit.load(path, map_location="cpu").eval()
                names = {"input_names": ["image"], "output_names": ["output"]}
                axes = {"image": {0: "B"}, "output": {0: "B"}}
                torch.onnx.export(network, (image,), file, dynamic_axes=axes, dynamo=False, opset_version=17, **names)
            return file.read_bytes()
        except Exception as error:  # PyTorch's exporter raises nearly anything
            reason = (str(error) or type(error).__name__).splitlines()[0]
            raise ModelError(f"{path}: PyTorch cannot export it: {reason[:300]}") from None
        finally:
            logging.disable(logging.NOTSET)
