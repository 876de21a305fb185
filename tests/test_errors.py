"""No message shows an error of the system as Python prints it: "[Errno 30] Read-only file system: 'x'"."""

from __future__ import annotations

import ast
from pathlib import Path

import edge
from edge.errors import reason

SOURCES = sorted(Path(edge.__file__).parent.rglob("*.py"))


def printed_as_they_are(source: str) -> list[int]:
    """Lines where what caught an OSError prints it by itself, in an f-string or as an argument of the log."""
    return [
        shown.lineno
        for handler in ast.walk(ast.parse(source))
        if isinstance(handler, ast.ExceptHandler) and handler.type and "OSError" in ast.unparse(handler.type)
        for node in ast.walk(handler)
        for shown in ([node.value] if isinstance(node, ast.FormattedValue) else _logged(node))
        if isinstance(shown, ast.Name) and shown.id == handler.name
    ]


def _logged(node: ast.AST) -> list[ast.expr]:
    is_log = isinstance(node, ast.Call) and ast.unparse(node.func).startswith("log.")
    return node.args if is_log and isinstance(node, ast.Call) else []


def test_no_error_of_the_system_is_printed_with_its_number() -> None:
    assert printed_as_they_are('try: ...\nexcept (OSError, ValueError) as error:\n log.warning("%s", error)') == [3]
    found = {str(path): lines for path in SOURCES if (lines := printed_as_they_are(path.read_text()))}
    assert not found
    assert reason(OSError(30, "Read-only file system")) == "Read-only file system"
    assert reason(ValueError("no number")) == "no number"
