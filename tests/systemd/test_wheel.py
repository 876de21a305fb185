"""What is installed from the wheel alone, or as README says: its commands, and nothing of what was measured."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import venv
import zipfile
from collections.abc import Callable
from importlib.metadata import Distribution, distribution
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from edge.descriptor.model_file import FC6_PACKAGE, GRID
from edge.extras import DISTRIBUTION
from tests.common import ROOT

README = ROOT / "README.md"
PARSE = """
import json, sys
from edge.commands.parser import build_parser
for words in json.loads(sys.argv[1]):
    args = build_parser(words).parse_args(words)
    print(args.run.__module__)
"""


def needed(*extras: str) -> list[Distribution]:
    """The packages that Lookback needs with some extras, and what they need."""
    found: dict[tuple[str, str], Distribution] = {}
    wanted = [(DISTRIBUTION, extra) for extra in ("", *extras)]
    while wanted:
        name, extra = wanted.pop()
        found[name, extra] = distribution(name)
        for need in map(Requirement, found[name, extra].requires or ()):
            if need.marker is None or need.marker.evaluate({"extra": extra}):
                wanted += [(need.name, one) for one in ("", *need.extras) if (need.name, one) not in found]
    return [one for (name, extra), one in found.items() if not extra and name != DISTRIBUTION]


def environment(folder: Path, *extras: str) -> tuple[Path, Path]:
    """An environment with links to the packages that are needed: its Python, and where packages are."""
    venv.create(folder)
    site = next(folder.glob("lib/python*/site-packages"))
    for one in needed(*extras):
        for top in {file.parts[0] for file in one.files or () if file.parts[0] not in ("..", "__pycache__")}:
            if not (site / top).exists():
                (site / top).symlink_to(Path(str(one.locate_file(top))))
    return folder / "bin/python", site


@pytest.fixture(scope="module")
def python(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An environment with the wheel, and what it needs."""
    python, site = environment(tmp_path_factory.mktemp("empty") / "venv")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(site)
    return python


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


@pytest.mark.long  # two whole tries from the wheel; that all is packed is tested above
@pytest.mark.parametrize(
    ("file", "said"),
    [("Makefile", r"--editable '\.\[([a-z,]+)\]'\n\ttouch"), ("README.md", r"'lookback-nav\[([a-z,]+)\]'")],
)
def test_try_needs_no_more_than_is_said(
    file: str, said: str, write_traverse: Callable[..., Path], tmp_path: Path
) -> None:
    """After `make demo`, and after the `pip install` of README; the code is the clone's, which has the network."""
    extras = re.search(said, (ROOT / file).read_text(encoding="utf-8"))
    assert extras is not None
    python, site = environment(tmp_path / "venv", *extras[1].split(","))
    (site / "clone.pth").write_text(str(ROOT))
    drives = [str(write_traverse(tmp_path / name)) for name in ("out", "home")]
    done = run(python, "-m", "edge", "try", *drives, "-o", str(tmp_path / "try"))
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "try/report.html").exists()
