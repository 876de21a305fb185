"""The examples in the docstrings of `lookback`, and that each public name has one place and one docstring."""

from __future__ import annotations

import doctest
import inspect
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

import lookback

MODULES = ("description", "matching", "scoring", "plotting")


@pytest.mark.parametrize("name", MODULES)
def test_the_examples_say_what_they_print(name: str) -> None:
    if name == "plotting":
        pytest.importorskip("matplotlib", reason="the extra `sim`")
    module = import_module(f"lookback.{name}")
    done = doctest.testmod(module, extraglobs={"np": np}, optionflags=doctest.ELLIPSIS)
    assert done.attempted > 0 and done.failed == 0


def test_every_public_name_is_documented_and_named_in_the_page_that_help_shows() -> None:
    page = lookback.__doc__ or ""
    for name in lookback.__all__:
        assert inspect.getdoc(getattr(lookback, name)), name
    functions = [name for name in lookback.__all__ if inspect.isfunction(getattr(lookback, name))]
    assert all(name in page for name in [*functions, "Map", "Recognizer", "Error"])
    assert dir(lookback) == sorted(lookback.__all__), "completion offers nothing else"


def test_it_needs_none_of_the_extras() -> None:
    program = "import sys, lookback; print({'matplotlib', 'jinja2', 'panda3d', 'onnx', 'IPython'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


def test_it_stays_a_front_door() -> None:
    lines = sum(len(file.read_text().splitlines()) for file in Path(lookback.__file__).parent.glob("*.py"))
    assert lines < 825  # of which 85 check arguments
