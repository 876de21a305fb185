"""The notebook runs as it is, and prints what is printed in it; CITATION.cff names the version."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from itertools import groupby
from pathlib import Path
from typing import Any

import pytest

from tests.common import ROOT

NOTEBOOK = ROOT / "docs/notebook.ipynb"
RUN = (
    "import nbformat, nbclient, sys; book = nbformat.read(sys.argv[1], 4);"
    "nbclient.NotebookClient(book, timeout=300, kernel_name='python3', record_timing=False).execute();"
    "nbformat.write(book, sys.argv[2])"
)


def shown(path: Path) -> list[str]:
    """What each cell of code printed, or the kinds of what it showed."""
    cells: list[dict[str, Any]] = json.loads(path.read_text(encoding="utf-8"))["cells"]
    found: list[str] = []
    for cell in cells:
        # What a cell prints comes in one piece, or in several on a busy machine.
        for is_text, outs in groupby(cell.get("outputs", ()), key=lambda out: "text" in out):
            pieces = ["".join(out["text"]) if is_text else " ".join(sorted(out["data"])) for out in outs]
            found += ["".join(pieces)] if is_text else pieces
    return found


@pytest.mark.long
def test_the_notebook_runs_and_prints_what_it_shows(tmp_path: Path) -> None:
    """If this fails for what is printed: make notebook"""
    for package in ("nbclient", "ipykernel", "panda3d"):
        pytest.importorskip(package, reason="the extras `docs` and `sim`")
    made = tmp_path / "made.ipynb"
    no_commands = {**os.environ, "PATH": "/usr/bin:/bin"}  # as where Jupyter is not started from the environment
    subprocess.run([sys.executable, "-c", RUN, str(NOTEBOOK), str(made)], env=no_commands, check=True)
    number = r"\d+(?:\.\d+)?"
    before, now = "\n".join(shown(NOTEBOOK)), "\n".join(shown(made))
    assert re.sub(number, "#", now) == re.sub(number, "#", before)
    # Processors render and round otherwise.
    numbers = [[float(one) for one in re.findall(number, text)] for text in (now, before)]
    assert numbers[0] == pytest.approx(numbers[1], rel=0.1, abs=0.1)
    assert len(shown(NOTEBOOK)) >= 10
