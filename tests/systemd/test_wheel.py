"""What is installed from the wheel alone: the commands of README, and nothing of what was measured to build it."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import venv
import zipfile
from importlib.metadata import Distribution, distribution
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from edge.descriptor.model_file import FC6_PACKAGE, GRID
from edge.extras import DISTRIBUTION

README = Path(__file__).parents[2] / "README.md"
PARSE = """
import json, sys
from edge.commands.parser import build_parser
for words in json.loads(sys.argv[1]):
    args = build_parser(words).parse_args(words)
    print(args.run.__module__)
"""


def core() -> list[Distribution]:
    """The packages that Lookback needs without any extra, and what they need."""
    found: dict[str, Distribution] = {}
    wanted = [DISTRIBUTION]
    while wanted:
        one = distribution(wanted.pop())
        for text in one.requires or ():
            need = Requirement(text)
            if need.name not in found and (need.marker is None or need.marker.evaluate({"extra": ""})):
                found[need.name] = distribution(need.name)
                wanted.append(need.name)
    return list(found.values())


@pytest.fixture(scope="module")
def python(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An environment with the wheel and links to the packages that it needs."""
    folder = tmp_path_factory.mktemp("empty") / "venv"
    venv.create(folder)
    site = next(folder.glob("lib/python*/site-packages"))
    for one in core():
        for top in {file.parts[0] for file in one.files or () if file.parts[0] not in ("..", "__pycache__")}:
            if not (site / top).exists():
                (site / top).symlink_to(Path(str(one.locate_file(top))))
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(site)
    return folder / "bin/python"


def run(python: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([str(python), *arguments], capture_output=True, text=True, check=False, cwd=python.parent)


def readme_commands() -> list[list[str]]:
    text = README.read_text(encoding="utf-8")
    blocks = re.findall(r"^```sh\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    lines = [line.removeprefix("sudo ") for block in blocks for line in block.splitlines()]
    return [shlex.split(line, comments=True)[1:] for line in lines if line.startswith("lookback ")]


def test_no_research_is_in_the_wheel(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    assert "sim/trial/run.py" in names and "sim/evaluation/report.html.j2" in names
    assert not [name for name in names if name.startswith(("sim/research", "tests", FC6_PACKAGE))]


def test_the_wheel_is_small_and_under_one_license(wheel: Path) -> None:
    """Without the network, which the fixture spares itself; its own file does not shrink."""
    size = wheel.stat().st_size + GRID.stat().st_size
    assert size < 10e6
    with zipfile.ZipFile(wheel) as archive:
        (metadata,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        assert "License-Expression: Apache-2.0\n" in archive.read(metadata).decode()


def test_every_command_of_the_readme_is_one(python: Path) -> None:
    commands = readme_commands()
    assert len(commands) > 5
    done = run(python, "-c", PARSE, json.dumps(commands))
    assert done.returncode == 0, done.stderr
    modules = done.stdout.split()
    assert {
        "sim.first_try.command",
        "sim.coverage.command",
        "sim.evaluation.replay",
        "edge_plugins.doctor.command",
    } <= set(modules)
    lacks_an_extra = [words for words, module in zip(commands, modules, strict=True) if module.endswith(".parser")]
    assert all(words[:2] == ["dev", "sim"] for words in lacks_an_extra)


def test_research_says_where_it_is(python: Path) -> None:
    done = run(python, "-m", "edge", "dev", "flights", "x")
    assert (done.returncode, done.stderr) == (
        78,
        "lookback: flights: only in a clone of the repository, not in the package\n",
    )
    done = run(python, "-m", "edge", "dev", "--help")
    assert done.returncode == 0, done.stderr
    assert re.search(r"flights +only in a clone", done.stdout)
    assert re.search(r"bench +measure this board", done.stdout)
