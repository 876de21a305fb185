"""The hint that adds packages must work where it is printed."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
import venv
from pathlib import Path

import pytest

from edge.extras import DISTRIBUTION, install_command
from tests.common import ROOT


def test_a_clone_is_installed_again_from_its_folder() -> None:
    assert install_command("sim,model") == shlex.join(
        [sys.executable, "-m", "pip", "install", "--editable", f"{ROOT}[sim,model]"]
    )


def test_elsewhere_the_installed_distribution_gets_its_extras(tmp_path: Path) -> None:
    command = shlex.split(install_command("page", package=tmp_path / "site-packages/edge"))
    assert command[-4:] == ["-m", "pip", "install", f"{DISTRIBUTION}[page]"]


@pytest.mark.long
def test_the_command_adds_an_extra_without_a_package_index(tmp_path: Path) -> None:
    """pip reads the extras of what is installed: neither the index nor the source is asked for the distribution."""
    venv.create(tmp_path / "venv", with_pip=True)
    python = tmp_path / "venv/bin/python"
    site = next((tmp_path / "venv/lib").glob("*/site-packages"))
    for name, lines in (
        (DISTRIBUTION, "Provides-Extra: page\nRequires-Dist: needed; extra == 'page'\n"),
        ("needed", ""),
    ):
        info = site / f"{name.replace('-', '_')}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n{lines}")
        (info / "INSTALLER").write_text("pip\n")
        (info / "RECORD").write_text("")
    command = [str(python), *shlex.split(install_command("page", package=site / "edge"))[-4:], "--no-index"]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    assert "already satisfied: needed" in result.stdout


def test_no_text_names_the_distribution_of_somebody_else() -> None:
    folders = ("edge", "edge_plugins", "sim", "docs", "systemd")
    files = [ROOT / "README.md", *(path for folder in folders for path in (ROOT / folder).rglob("*"))]
    for file in files:
        if file.suffix in (".py", ".md", ".sh", ".toml"):
            assert not re.search(r"install '?lookback(?!-nav)\b", file.read_text(encoding="utf-8")), file
