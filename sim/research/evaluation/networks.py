"""The networks of a plan: files that `lookback model import` wrote, or graphs built from the weights."""

from __future__ import annotations

import hashlib
from functools import lru_cache
from pathlib import Path
from typing import Literal

import msgspec

from edge.descriptor.model_file import ModelFile, resolve_model
from edge.descriptor.network import Network
from edge.errors import ConfigError
from sim.research.alexnet.command import as_int8, read_layer_ranges
from sim.research.alexnet.graph import alexnet_info, build_float
from sim.research.alexnet.weights import read_weights
from sim.research.evaluation.plan import NetworkPlan

Tap = Literal["fc6", "conv3"]
Precision = Literal["int8", "float32"]
_weights = lru_cache(maxsize=2)(read_weights)


@lru_cache(maxsize=16)
def open_network(name: str, plan: NetworkPlan, folder: Path, tap: Tap) -> Network:
    """A layer of a network in int8 if available, else in float. Opened once in a process.

    ConfigError names what is missing.
    """
    precisions: tuple[Precision, ...] = ("int8", "float32")
    for one in precisions:
        file = _file_of(folder / plan.model if plan.model else None, tap, one)
        if file.is_file():
            return Network.load(file)
        if plan.weights and (one == "float32" or plan.ranges):
            return Network(_make(plan, folder, tap, one))
    raise ConfigError(
        f"[networks.{name}]: has no {tap}; give it weights, or import it with `lookback dev alexnet --tap {tap}`"
    )


def _file_of(model: Path | None, tap: Tap, precision: Precision) -> Path:
    """The file of an AlexNet's layer; of another network its own descriptor stands for fc6."""
    file = resolve_model(model, f"{tap}_{precision}.onnx")
    other = file.with_name(f"network_{precision}.onnx")
    return other if tap == "fc6" and not file.exists() and model is not None and model.is_dir() else file


def _make(plan: NetworkPlan, folder: Path, tap: Tap, precision: Precision) -> ModelFile:
    weights, sha256 = _weights(folder / plan.weights)
    info = alexnet_info(
        Path(plan.weights).name.partition(".")[0],
        tap,
        license="as that of the weights",
        source=plan.weights,
        weights_sha256=sha256,
        calibration=plan.ranges,
    )
    info = msgspec.structs.replace(info, precision=precision)
    model = build_float(weights, info)
    if precision == "int8":
        model = as_int8(model, read_layer_ranges(folder / plan.ranges), info)
    data = model.SerializeToString(deterministic=True)
    info = msgspec.structs.replace(info, sha256=hashlib.sha256(data).hexdigest())
    return ModelFile(folder / plan.weights, data, info)
