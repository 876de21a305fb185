"""Checkpoints of PyTorch in both of its formats, read without PyTorch; and files that are none."""

from __future__ import annotations

import io
import pickle
import sys
import zipfile
from collections import OrderedDict
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from edge.errors import ModelError
from sim.model_tools.torch_file import read_state

LEGACY_MAGIC, PROTOCOL_VERSION = 0x1950A86A20F9469CFC6C, 1001


@pytest.fixture(autouse=True)
def torch_names(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The names that a checkpoint's pickle refers to, in the modules where PyTorch has them."""
    torch, inner = ModuleType("torch"), ModuleType("torch._utils")

    def rebuild(*_: Any) -> None: ...

    for module, name, value in (
        (torch, "FloatStorage", type("FloatStorage", (), {"__module__": "torch"})),
        (inner, "_rebuild_tensor_v2", rebuild),
    ):
        value.__module__, value.__qualname__ = module.__name__, name
        setattr(module, name, value)
    monkeypatch.setitem(sys.modules, "torch", torch)
    monkeypatch.setitem(sys.modules, "torch._utils", inner)
    return torch


class Tensor:
    """Pickled as PyTorch pickles a tensor: a call that is given its numbers by key."""

    def __init__(self, array: np.ndarray, key: str) -> None:
        self.array, self.key = array, key

    def __reduce__(self) -> Any:
        storage = Storage(self.key, self.array.size)
        strides = tuple(step // self.array.itemsize for step in self.array.strides)
        rebuild = sys.modules["torch._utils"]._rebuild_tensor_v2
        return rebuild, (storage, 0, self.array.shape, strides, False, OrderedDict())


class Storage:
    def __init__(self, key: str, count: int) -> None:
        self.key, self.count = key, count


class Pickler(pickle.Pickler):
    def persistent_id(self, obj: Any) -> Any:
        if isinstance(obj, Storage):
            return "storage", sys.modules["torch"].FloatStorage, obj.key, "cpu", obj.count
        return None


def pickled(value: Any) -> bytes:
    stream = io.BytesIO()
    Pickler(stream, 2).dump(value)
    return stream.getvalue()


ARRAYS = {"fc.weight": np.arange(6, dtype=np.float32).reshape(2, 3), "fc.bias": np.array([7, 8], np.float32)}


def state() -> Any:
    return {"epoch": 90, "state_dict": OrderedDict((name, Tensor(array, name)) for name, array in ARRAYS.items())}


def legacy() -> bytes:
    numbers = b"".join(len(array.ravel()).to_bytes(8, "little") + array.tobytes() for array in ARRAYS.values())
    parts: tuple[Any, ...] = (LEGACY_MAGIC, PROTOCOL_VERSION, {"little_endian": True}, state(), list(ARRAYS))
    return b"".join(map(pickled, parts)) + numbers


def archive() -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as file:
        file.writestr("net/data.pkl", pickled(state()))
        for name, array in ARRAYS.items():
            file.writestr(f"net/data/{name}", array.tobytes())
    return stream.getvalue()


@pytest.mark.parametrize("data", [legacy, archive])
def test_both_formats(data: Any) -> None:
    found = read_state(Path("net.pth"), data())
    assert found.keys() == ARRAYS.keys()
    for name, array in ARRAYS.items():
        np.testing.assert_array_equal(found[name], array)


@pytest.mark.parametrize("data", [legacy, archive])
def test_every_cut_is_one_line(data: Any) -> None:
    whole = data()
    for length in range(0, len(whole) - 1, 7):
        with pytest.raises(ModelError, match=r"^net\.pth: not a PyTorch checkpoint of weights: ") as caught:
            read_state(Path("net.pth"), whole[:length])
        assert "\n" not in str(caught.value)


class Program:
    def __reduce__(self) -> Any:
        return print, ("a program ran",)


def test_a_pickle_that_runs_a_program_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    parts: tuple[Any, ...] = (LEGACY_MAGIC, PROTOCOL_VERSION, {}, {"state_dict": {"a": Program()}}, [])
    with pytest.raises(ModelError, match=r"it holds __builtin__\.print, and not only weights"):
        read_state(Path("net.pth"), b"".join(map(pickled, parts)))
    assert capsys.readouterr().out == ""


def test_a_tensor_that_claims_more_than_there_is() -> None:
    array = np.lib.stride_tricks.as_strided(np.zeros(1, np.float32), (4000, 4000), (0, 4))
    tensor = Tensor(array, "x")
    tensor.array = array
    parts: tuple[Any, ...] = (LEGACY_MAGIC, PROTOCOL_VERSION, {}, {"x": tensor}, ["x"])
    with pytest.raises(ModelError, match="it claims 16000000 numbers and is shorter"):
        read_state(Path("net.pth"), b"".join(map(pickled, parts)))
