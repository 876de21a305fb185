"""Every number that decides on a position has its reason beside it."""

from __future__ import annotations

import ast
import math
from pathlib import Path

import pytest

from edge.localization.state import OF_ALL, OF_DRIVE

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


def test_the_docs_have_each_part_of_the_state_and_within_what_it_changes() -> None:
    rows = (EDGE.parent / "docs/noises.md").read_text(encoding="utf-8").splitlines()
    for part in OF_ALL + OF_DRIVE:
        over = [f"| {one:g} {unit} |" for one, unit in ((part.over_m, "m"), (part.over_s, "s")) if one < math.inf]
        assert any(row.startswith(f"| {part.what}") and all(one in row for one in over) for row in rows), part.what
