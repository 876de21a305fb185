"""`lookback model providers`: each installed provider of ONNX Runtime beside the CPU, as `lookback run` uses it."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from edge.descriptor.model_file import read_model_file, resolve_model
from edge.descriptor.network import CPU, Network, installed_providers, provider_name
from edge.descriptor.open_network import NSD_COSINE_MIN, check_pictures, nsd_cosines
from edge.errors import ModelError
from sim.bench.timing import race

ROUNDS = 21
REMOTE = "AzureExecutionProvider"
"""In every build; it calls a service on the network, and would run all of this on the CPU."""
COLUMNS = ("network", "provider", "cosine to the CPU after NSD", "used", "CPU time of a frame, ms", "the CPU's, ms")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The networks to try."""
    parser.add_argument("models", type=Path, nargs="*", metavar="MODEL", help="folders or files (default: the shipped)")
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    print("| " + " | ".join(COLUMNS) + " |")
    print("|" + "---|" * len(COLUMNS))
    names = [name for name in installed_providers() if name != REMOTE]
    for model in args.models or [None]:
        for name in names:
            if name != provider_name(CPU) or len(names) == 1:
                print("| " + " | ".join(_compared(model, name)) + " |", flush=True)
    return 0


def _compared(model: Path | None, provider: str) -> tuple[str, ...]:
    """A row of the table; times are of the process on all cores, since some providers use threads of their own."""
    file = read_model_file(resolve_model(model))
    exact = Network(file)
    label = model.name if model else exact.info.name
    try:
        network = Network(file, provider)
    except ModelError as error:
        return label, provider, str(error), "no", "", ""
    pictures = check_pictures(exact.size)
    one, other = (np.stack([each.describe(pair) for pair in pictures]) for each in (exact, network))
    cosine = float(nsd_cosines(one, other).mean())
    times = race(
        {"provider": lambda: network.describe(pictures[0]), "cpu": lambda: exact.describe(pictures[0])},
        ROUNDS,
        time.process_time_ns,
    )
    is_used = "yes" if cosine >= NSD_COSINE_MIN else "no"
    own_ms, cpu_ms = (f"{times[name].median_ms:.1f}" for name in ("provider", "cpu"))
    return label, provider.removesuffix("ExecutionProvider"), f"{cosine:.4f}", is_used, own_ms, cpu_ms
