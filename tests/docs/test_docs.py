"""Everything that the docs tell people to type is typed here, in an empty folder for each page, from top to bottom.

A ```toml block that begins with `# NAME.toml` is that file, any other must be a good config; each ```sh block is run by
bash and must succeed.
"""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
from pathlib import Path
from typing import get_args

import pytest

from edge.config import parse_config

pytest.importorskip("panda3d")
pytest.importorskip("gpxpy")

ROOT = Path(__file__).parents[2]
PAGES = sorted((ROOT / "docs").glob("*.md"))
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
MOST_S = 600


def script_of(text: str, page: Path, folder: Path) -> str:
    """Writes the files that a page's text shows, and gives its commands."""
    commands = []
    for kind, block in BLOCK.findall(text):
        assert kind in ("sh", "toml"), f"{page.name}: a block of {kind or 'nothing'} is not run by anything"
        if kind == "toml":
            if name := re.match(r"# ([\w.]+\.toml)\n", block):
                (folder / name[1]).write_text(block, encoding="utf-8")
            else:
                parse_config(block, page)
        else:
            commands.append(block)
    # What was started in the background would keep the test waiting.
    return "\n".join([*commands, "kill $(jobs -p) 2> /dev/null || true"])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_command_works(page: Path, tmp_path: Path) -> None:
    run_in(tmp_path, script_of(page.read_text(encoding="utf-8"), page, tmp_path))


def test_the_readme_can_be_followed_on_a_recording(shared: Path, tmp_path: Path) -> None:
    """All of its section that begins with a demo behind one, and with no hardware."""
    readme = ROOT / "README.md"
    text = readme.read_text(encoding="utf-8").split("\n## Try it on a recording\n")[1].split("\n## ")[0]
    (tmp_path / "shared").symlink_to(shared)
    (tmp_path / "checkout").mkdir()
    script = script_of(text, readme, tmp_path / "checkout").replace(". .venv/bin/activate ", ": ")
    output = run_in(tmp_path / "checkout", script)
    (found_m,) = re.findall(r"reverse, same +the place lies +([-\d.]+) m ahead", output)
    assert float(found_m) == pytest.approx(6.0, abs=2.0), "what the simulator was given"
    assert "on the map" in output


def run_in(folder: Path, script: str) -> str:
    """What a script prints, which must succeed."""
    environment = {**os.environ, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    with subprocess.Popen(
        ["bash", "-euxo", "pipefail", "-c", script],
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    ) as process:
        try:
            output, _ = process.communicate(timeout=MOST_S)
        finally:
            with contextlib.suppress(ProcessLookupError):  # its session, should it have been too slow
                os.killpg(process.pid, signal.SIGTERM)
    assert process.returncode == 0, output[-3000:]
    assert "Traceback" not in output
    return output


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_link_leads_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#:]+)\)", page.read_text(encoding="utf-8")):
        assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_every_state_is_explained() -> None:
    from edge.health.health import HealthState

    page = (ROOT / "docs/vehicle.md").read_text(encoding="utf-8")
    for state in get_args(HealthState):
        assert f"| {state} |" in page


def test_every_key_that_the_docs_name_exists() -> None:
    """Words in code type that look like a key, such as `spacing_m`, are one, or else a word of the program's."""
    from edge.config import DEFAULT_TOML
    from sim.world import scenario

    known = set(re.findall(r"^(\w+) = ", DEFAULT_TOML.read_text(encoding="utf-8"), re.MULTILINE))
    known |= set(scenario.Scenario.__struct_fields__)
    # What journal and messages call things.
    for source in (ROOT / "edge").rglob("*.py"):
        known |= set(re.findall(r"\b([a-z]+(?:_[a-z]+)+)\b", source.read_text(encoding="utf-8")))
    for page in PAGES:
        for word in re.findall(r"`(?:\[\w+\] )?([a-z]+(?:_[a-z]+)+)`", page.read_text(encoding="utf-8")):
            assert word in known, f"{page.name}: {word}"
