"""Finds out whether a file of the user hides a package of Lookback: a `sim.py` beside a script comes before ours."""

from importlib.util import find_spec
from pathlib import Path

HERE = Path(__file__).resolve().parents[1]
for name in ("edge", "edge_plugins", "sim"):
    spec = find_spec(name)
    if spec is not None and spec.origin and Path(spec.origin).resolve() != HERE / name / "__init__.py":
        raise ImportError(f"{spec.origin} hides the package {name!r} that Lookback is made of: rename it")
