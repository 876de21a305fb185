"""A plan from the options of `lookback compare`: two recordings, and what is added to any plan."""

from __future__ import annotations

import argparse
import re
from pathlib import Path

import msgspec

from edge.config import NETWORKS
from edge.errors import ConfigError
from sim.compare.methods import METHODS, SEQUENCES
from sim.compare.plan import NetworkPlan, Plan, checked_plan
from sim.datasets.found import read_drive
from sim.evaluation.metrics import TOLERANCE_M
from sim.traverse import driven_m

DEFAULT_METHODS = ["Raw-single", "NSD-single", "NSD-CR", "Lookback", "SeqSLAM"]
SPACING_M, TOLERANCE_FRAMES = 2.0, 5.0
"""Of drives whose meters are known, as in the paper; and of those whose are not."""
BOTH = 2


def plan_of(args: argparse.Namespace) -> Plan:
    """The plan of a reference and a query. ConfigError."""
    if len(args.what) != BOTH:
        raise ConfigError("compare: needs a plan, or two recordings: the reference, then the query")
    reference, query = (path.resolve() for path in args.what)
    is_metric = all(driven_m(read_drive(path)) is not None for path in (reference, query))
    truth = args.truth or ("positions" if is_metric else "rows")
    tolerance = TOLERANCE_M if is_metric and truth in ("positions", "route_m") else TOLERANCE_FRAMES
    pair = {
        "name": f"{query.stem} on {reference.stem}",
        "reference": "reference",
        "query": "query",
        "truth": str(Path(truth).resolve()) if truth.endswith(".npy") else truth,
        "soft": str(args.soft.resolve()) if args.soft else "",
        "transposed": args.transposed,
        "tolerance": tolerance if args.tolerance is None else args.tolerance,
        "ahead": args.ahead,
        "length": args.length,
    }
    given = {
        "title": pair["name"],
        "methods": DEFAULT_METHODS,
        "networks": {"grid": {"model": "grid"}},
        "traverses": {"reference": {"feed": str(reference)}, "query": {"feed": str(query)}},
        "pairs": [pair],
        "sampling": {"by": "distance", "spacing_m": SPACING_M} if is_metric else {"by": "frames"},
    }
    return checked_plan(Path("compare"), given)


def with_options(plan: Plan, args: argparse.Namespace) -> Plan:
    """The plan with the networks, descriptors, similarities and methods of the options as well. ConfigError.

    What an option adds has its rows beside those of `--method`, unless `--method` names rows of it.
    """
    networks, pairs, methods = dict(plan.networks), list(plan.pairs), list[str](args.method or plan.methods)
    chosen = tuple(methods)

    def add(rows: list[str], name: str) -> None:
        if not any(name in (row.partition("@")[2], row.removesuffix(SEQUENCES)) for row in args.method):
            methods.extend(rows)

    for text in args.network:
        name, file = _named("--network", text)
        size = re.fullmatch(r"(.+):(\d+)x(\d+)", file)
        given = {"model": size[1], "size": (int(size[2]), int(size[3]))} if size else {"model": file}
        if given["model"] not in NETWORKS:
            given["model"] = str(Path(str(given["model"])).resolve())
        networks[name] = msgspec.convert(given, NetworkPlan)
        add([f"{row}@{name}" for row in chosen if row in METHODS and METHODS[row].layer == "fc6"], name)
    for text in args.descriptors:
        name, files = _named("--descriptors", text)
        both = [str(Path(file).resolve()) for file in files.split(",")]
        if len(both) != BOTH:
            raise ConfigError(f"--descriptors: {text!r} is not NAME=REFERENCE.npy,QUERY.npy")
        networks[name] = NetworkPlan(descriptors=dict(zip(("reference", "query"), both, strict=True)))
        add([f"{row}@{name}" for row in ("Raw-single", "NSD-fc6")], name)
    for text in args.similarity:
        name, file = _named("--similarity", text)
        matrix = {name: str(Path(file).resolve())}
        pairs = [msgspec.structs.replace(pair, similarity=pair.similarity | matrix) for pair in pairs]
        add([name, f"{name}{SEQUENCES}"], name)
    return msgspec.structs.replace(plan, networks=networks, pairs=pairs, methods=methods)


def _named(option: str, text: str) -> tuple[str, str]:
    """NAME=FILE. ConfigError for other text."""
    name, _, file = text.partition("=")
    if not (name and file) or {"@", "/"} & set(name):
        raise ConfigError(f"{option}: {text!r} is not NAME=FILE")
    return name, file
