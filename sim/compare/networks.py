"""The networks of a plan: one that comes with Lookback, a file of `lookback model import`, or anybody's ONNX file."""

from __future__ import annotations

from pathlib import Path

from edge.config import NETWORKS
from edge.descriptor.model_file import resolve_model
from edge.descriptor.network import Network
from edge.errors import ConfigError
from sim.compare.foreign import open_file
from sim.compare.plan import NetworkPlan


def open_network(name: str, plan: NetworkPlan, folder: Path) -> Network:
    """ConfigError names what is missing."""
    if plan.model in NETWORKS:
        return Network.load(Path(plan.model))
    file = folder / plan.model
    file = resolve_model(file) if file.is_dir() else file
    if not file.is_file():
        raise ConfigError(f"[networks.{name}]: {file}: no such network")
    return open_file(file, plan.size, plan.mean, plan.std)
