"""Lookback's own wheel, built once."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the checkout without the weights, which would be zipped and unzipped in every test."""
    checkout = tmp_path_factory.mktemp("checkout")
    shutil.copy(ROOT / "pyproject.toml", checkout)
    (checkout / "README.md").touch()
    for package in ("edge", "sim", "systemd"):
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
