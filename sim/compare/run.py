"""What `lookback compare` does: all comparisons of a plan, in one report."""

from __future__ import annotations

import argparse
import hashlib
import platform
import shlex
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import msgspec
from tqdm import tqdm

import edge
from edge.config import SamplingConfig
from edge.errors import ConfigError
from sim.compare.comparison import as_short, compare, networks_section, overview, pair_section
from sim.compare.descriptions import Descriptions
from sim.compare.method_runner import MethodRunner
from sim.compare.options import plan_of, with_options
from sim.compare.plan import Plan, TraversePlan, load_plan
from sim.compare.traverses import MethodTraverse, load_traverse
from sim.evaluation.report import ReportSection, Table, as_latex, as_markdown, write_report
from sim.output import needing

SHIPPED = Path(__file__).with_name("plans")
PACKAGES = ("numpy", "onnxruntime", "opencv-python-headless", "numkong", "matplotlib")


def run_plan(runner: MethodRunner) -> Iterator[ReportSection]:
    """All comparisons of a plan, section by section."""
    plan = runner.plan
    with tqdm(total=len(plan.methods) * len(plan.pairs), unit="step", desc="plan") as progress:

        def step(what: str) -> None:
            progress.set_postfix_str(what)
            progress.update()

        results = compare(runner, step)
        yield overview(runner, results)
        for pair in plan.pairs:
            yield pair_section(runner, pair, results)
        yield networks_section(runner, results)


@dataclass(frozen=True)
class Folders:
    """Folders of the plan's scenarios, feeds and models; scenarios are rendered into `rendered`."""

    scenarios: Path
    feeds: Path
    models: Path
    rendered: Path


def open_runner(plan: Plan, folders: Folders) -> MethodRunner:
    """A runner that reads traverses when they are first needed."""

    def open_traverse(name: str) -> MethodTraverse:
        traverse = plan.traverses[name]
        if traverse.scenario:
            paths = [feed_of(traverse, folders.scenarios, folders.rendered, plan.sampling)]
        else:
            paths = [folders.feeds / feed for feed in traverse.feeds or (traverse.feed,)]
        return load_traverse(name, traverse, paths, plan.sampling)

    return MethodRunner(plan, Descriptions(plan, folders.models, folders.feeds), open_traverse, folders.feeds)


def run(args: argparse.Namespace) -> int:
    """Run a plan and write its report; SetupError, in one line, for any error in it."""
    if len(args.what) == 1 and not args.what[0].is_dir():
        path = find_plan(args.what[0])
        plan, source = load_plan(path), f"{path.name}, sha256 {hashlib.sha256(path.read_bytes()).hexdigest()}"
    else:
        path, source = Path("options"), "the command's options"
        plan = plan_of(args)
    plan = with_options(plan, args)
    runner = open_runner(plan, folders_of(args, path))
    for text in plan.methods:
        runner.method(text)
    sections = list(run_plan(runner))
    page = write_report(args.output, plan.title, about(source, plan, runner), sections)
    made = f"{plan.title}. Made by Lookback {edge.__version__}."
    for table in sections[0].tables:
        (args.output / f"{table.name}.md").write_text(f"{as_markdown(table)}\n\n{made}\n", encoding="utf-8")
        (args.output / f"{table.name}.tex").write_text(f"% {made}\n{as_latex(table)}\n", encoding="utf-8")
    print_table(sections[0].tables[0])
    print(page)
    return 0


def folders_of(args: argparse.Namespace, path: Path) -> Folders:
    """The folders that the options name, or else that of the plan. ConfigError if the report cannot be written."""
    try:
        args.output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"{args.output}: cannot write the report here: {error.strerror}") from None
    beside = path.parent
    return Folders(beside, args.feeds or beside, args.models or beside, args.output / "feeds")


def find_plan(path: Path) -> Path:
    """A file, or one of the shipped plans by its name."""
    shipped = SHIPPED / f"{path}.toml"
    return shipped if not path.exists() and shipped.is_file() else path


def about(source: str, plan: Plan, runner: MethodRunner) -> dict[str, str]:
    """What is needed to run the same again."""
    terms = {
        "command": shlex.join(["lookback", *sys.argv[1:]]),
        "plan": source,
        "lookback": edge.__version__,
        "python": platform.python_version(),
        "packages": ", ".join(f"{package} {version(package)}" for package in PACKAGES),
        "machine": f"{platform.machine()}, {platform.system()}",
    }
    for name, network in runner.descriptions.opened().items():
        info = network.info
        terms[f"network {name}: {info.name}, {info.output}, {info.precision}"] = f"sha256 {info.sha256}"
    return terms | ({"notes": plan.notes} if plan.notes else {})


def print_table(table: Table) -> None:
    """The table on the terminal, and what it warns of."""
    rows = [table.columns, *([as_short(cell) for cell in row] for row in table.rows)]
    widths = [max(len(row[column]) for row in rows) for column in range(len(table.columns))]
    for row in rows:
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
    if table.note:
        print(table.note, file=sys.stderr)


def feed_of(plan: TraversePlan, folder: Path, rendered: Path, sampling: SamplingConfig) -> Path:
    """The feed of a scenario, recorded in `rendered` unless it is there."""
    with needing("the plan's scenarios", "sim"):
        from sim.world.recording import recorded
        from sim.world.scenario import load_scenario
    scenario = load_scenario(folder / plan.scenario)
    if plan.seed is not None:
        scenario = msgspec.structs.replace(scenario, seed=plan.seed)
    return recorded(scenario, rendered, sampling.spacing_m, Path(plan.scenario).stem)
