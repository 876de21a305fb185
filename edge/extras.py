"""The packages that only some users need: how to add them to the installation that is running."""

from __future__ import annotations

import os
import shlex
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType

from edge.errors import ConfigError

DISTRIBUTION = "lookback-nav"
"""The name on PyPI, where `lookback` belongs to another project. The command and the packages keep their names."""


def import_extra(module: str, extra: str, needs: str) -> ModuleType:
    """A module of a package that only some users need; ConfigError says what `needs` it, and how to add it."""
    try:
        return import_module(module)
    except ImportError:
        raise ConfigError(f"{needs}: {install_command(extra)}") from None


def install_command(extras: str, package: Path = Path(__file__).parent) -> str:
    """The command that adds extras ("page", or "sim,model") here: to a clone, the service's environment or another.

    package: the folder of `edge`, which in a clone lies beside pyproject.toml.
    """
    clone = package.parent
    if (clone / "pyproject.toml").is_file():
        what = ["--editable", f"{clone}[{extras}]"]
    else:
        what = [f"{DISTRIBUTION}[{extras}]"]  # pip installs what is missing, and keeps the version that is installed
    sudo = [] if os.access(sys.prefix, os.W_OK) else ["sudo"]
    return shlex.join([*sudo, sys.executable, "-m", "pip", "install", *what])
