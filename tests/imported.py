"""What a file imports, as names of modules."""

from __future__ import annotations

import ast
from pathlib import Path

from tests.common import ROOT


def imports(file: Path) -> set[str]:
    """Full names of all modules that a file imports, at any depth."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {name.name for name in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file}: relative import"
            module = node.module or ""
            below = {f"{module}.{name.name}" for name in node.names}
            modules = {name for name in below if is_module(name)}
            found |= modules if modules == below else {module, *modules}
    return found


def is_module(name: str) -> bool:
    """Whether there is a file of ours with that name."""
    path = ROOT / name.replace(".", "/")
    return path.with_suffix(".py").is_file() or (path / "__init__.py").is_file()
