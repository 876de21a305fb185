"""Every number that decides on a position has its reason beside it."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

EDGE = Path(__file__).parents[2] / "edge"
ROOMS = [path for room in ("localization", "sequence") for path in sorted((EDGE / room).glob("*.py"))]


@pytest.mark.parametrize("path", ROOMS, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_each_constant_has_its_reason_beside_it(path: Path) -> None:
    """A docstring after it, or a comment on its line."""
    source = path.read_text(encoding="utf-8")
    body, lines = ast.parse(source).body, source.splitlines()
    bare = [
        node.lineno
        for node, after in zip(body, [*body[1:], None], strict=True)
        if isinstance(node, ast.Assign)
        and any(isinstance(one, ast.Constant) and isinstance(one.value, int | float) for one in ast.walk(node.value))
        and not (isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant))
        and "#" not in lines[(node.end_lineno or node.lineno) - 1]
    ]
    assert not bare, f"{path}: lines without a reason: {bare}"
