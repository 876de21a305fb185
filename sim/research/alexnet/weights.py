"""AlexNet's weights in torchvision's layout: read, and checked.

The layout is that of torchvision.models.alexnet
(https://github.com/pytorch/vision/blob/main/torchvision/models/alexnet.py) and of the published Places365 network. What
follows fc6 is not read.
"""

from __future__ import annotations

import hashlib
import pickle
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.errors import ModelError
from edge.extras import install_command
from sim.model_tools.onnx_graph import Weights


@dataclass(frozen=True)
class Conv:
    """A convolution of torchvision's `features`, and whether a max pool (3, stride 2) follows its ReLU."""

    layer: str
    shape: tuple[int, int, int, int]
    stride: int
    pad: int
    pool: bool


CONVS = (
    Conv("features.0", (64, 3, 11, 11), stride=4, pad=2, pool=True),
    Conv("features.3", (192, 64, 5, 5), stride=1, pad=2, pool=True),
    Conv("features.6", (384, 192, 3, 3), stride=1, pad=1, pool=False),
    Conv("features.8", (256, 384, 3, 3), stride=1, pad=1, pool=False),
    Conv("features.10", (256, 256, 3, 3), stride=1, pad=1, pool=True),
)
FC6 = "classifier.1"
FC6_SHAPE = (4096, 9216)


def read_weights(path: Path) -> tuple[Weights, str]:
    """Weights as float32 by torchvision's names, and the file's sha256. ModelError names the file and the layer."""
    try:
        sha256 = hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise ModelError(f"{path}: cannot read the weights: {error.strerror}") from None
    raw = _read_npz(path) if path.suffix == ".npz" else _read_checkpoint(path)
    # Published checkpoints were saved from DataParallel, which puts "module." into the names.
    weights = {name.replace("module.", ""): np.asarray(value, dtype=np.float32) for name, value in raw.items()}
    _check_weights(path, weights)
    return weights, sha256


def _read_npz(path: Path) -> Mapping[str, NDArray[Any]]:
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as arrays:
            return dict(arrays)
    except (zipfile.BadZipFile, zlib.error, ValueError, EOFError, MemoryError, NotImplementedError) as error:
        raise ModelError(f"{path}: not a whole .npz file: {error}") from None


def _read_checkpoint(path: Path) -> Mapping[str, Any]:
    """A state dictionary that PyTorch saved, or a checkpoint that has one; nothing in it is run."""
    try:
        import torch
    except ImportError:
        raise ModelError(f"{path}: needs PyTorch to be read: {install_command('torch')}") from None
    try:
        checkpoint = torch.load(path, map_location="cpu", weights_only=True)
        return dict(checkpoint.get("state_dict", checkpoint))
    except (RuntimeError, pickle.UnpicklingError, EOFError, AttributeError, TypeError, ValueError) as error:
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise ModelError(f"{path}: not a PyTorch checkpoint of weights: {reason}") from None


def _check_weights(path: Path, weights: Weights) -> None:
    """All layers up to fc6 in AlexNet's shapes."""
    shapes: dict[str, tuple[int, ...]] = {conv.layer: conv.shape for conv in CONVS}
    shapes[FC6] = FC6_SHAPE
    for layer, shape in shapes.items():
        for name, wanted in ((f"{layer}.weight", shape), (f"{layer}.bias", shape[:1])):
            if name not in weights:
                raise ModelError(f"{path}: no {name}; these are not AlexNet's weights by torchvision's names")
            if weights[name].shape != wanted:
                raise ModelError(f"{path}: {name} has the shape {weights[name].shape}, AlexNet's is {wanted}")
            if not np.isfinite(weights[name]).all():
                raise ModelError(f"{path}: {name} has values that are not finite")
