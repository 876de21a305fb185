"""Lookback's own wheel, and an environment of Python, each made once."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.common import ROOT


@pytest.fixture(scope="session")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the checkout without the weights, which would be zipped and unzipped in every test."""
    checkout = tmp_path_factory.mktemp("checkout")
    shutil.copy(ROOT / "pyproject.toml", checkout)
    shutil.copy(ROOT / "setup.py", checkout)
    (checkout / "README.md").touch()
    for package in ("edge", "edge_plugins", "sim", "systemd"):
        shutil.copytree(ROOT / package, checkout / package, ignore=shutil.ignore_patterns("models", "__pycache__"))
    return checkout


@pytest.fixture(scope="session")
def wheel(
    checkout: Path, make_once: Callable[[str, Callable[[Path], object]], Path], tmp_path_factory: pytest.TempPathFactory
) -> Path:
    source = tmp_path_factory.mktemp("source") / "copy"

    def build(folder: Path) -> None:
        shutil.copytree(checkout, source)  # building leaves files in it
        command = [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", str(folder), str(source)]
        built = subprocess.run(command, capture_output=True, text=True, check=False)
        if "No matching distribution found for setuptools" in built.stderr:
            pytest.skip("needs a package index, for setuptools")
        assert built.returncode == 0, built.stderr

    return next(make_once("wheel", build).glob("lookback_nav-*.whl"))


COPIES_ENVIRONMENTS = """#!/bin/sh
# {python}, but `-m venv FOLDER` copies an environment that was made before, with all paths in it
[ "$1 $2" = "-m venv" ] || exec {python} "$@"
cp -a {made} "$3"
grep -rlIF -- {paths} "$3/bin" "$3/pyvenv.cfg" | xargs sed -i "s|{paths}|$3|g"
"""


@pytest.fixture(scope="session")
def quick_python(make_once: Callable[[str, Callable[[Path], object]], Path]) -> Callable[..., Path]:
    """Writes a Python that is another one, and makes environments without the 4 s that unpacking pip takes each time.

    The first installation of `test_install` and `make test-boot` make theirs in full.
    """

    def fill(folder: Path) -> None:
        subprocess.run([sys.executable, "-m", "venv", str(folder / "venv")], check=True)
        (folder / "paths").write_text(str(folder / "venv"))

    made = make_once("environment", fill)

    def write(path: Path, python: str | Path = sys.executable) -> Path:
        paths = (made / "paths").read_text()
        path.write_text(COPIES_ENVIRONMENTS.format(python=python, made=made / "venv", paths=paths))
        path.chmod(0o755)
        return path

    return write
