"""The networks of a plan: one that comes with Lookback, a file of `lookback model import`, or anybody's ONNX file."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from edge.config import NETWORKS
from edge.descriptor.model_file import resolve_model
from edge.descriptor.network import Network
from edge.errors import ConfigError
from sim.compare.foreign import open_file
from sim.compare.plan import NetworkPlan

Tap = Literal["fc6", "conv3"]
"""The network's own descriptor, which an AlexNet has from fc6; or AlexNet's layer conv3."""


def open_network(name: str, plan: NetworkPlan, folder: Path, tap: Tap) -> Network:
    """A layer of a network. ConfigError names what is missing."""
    if tap == "conv3":
        if not plan.conv3:
            raise ConfigError(f"[networks.{name}]: has no conv3; name the file that `lookback dev alexnet` made of it")
        return Network.load(folder / plan.conv3)
    if plan.model in NETWORKS:
        return Network.load(Path(plan.model))
    file = folder / plan.model
    file = resolve_model(file) if file.is_dir() else file
    if not file.is_file():
        raise ConfigError(f"[networks.{name}]: {file}: no such network")
    return open_file(file, plan.size, plan.mean, plan.std)
