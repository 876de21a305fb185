"""Nothing that is read can run: no pickle, no eval, no arrays of objects, on a vehicle and at a desk."""

from __future__ import annotations

import ast

from tests.common import ROOT

MODULES = {"pickle", "marshal", "shelve", "dill", "cloudpickle", "joblib", "yaml"}
CALLS = {"eval", "exec", "compile", "__import__"}


def words(node: ast.AST) -> set[str]:
    """What a node of the program names that could run what it reads."""
    if isinstance(node, ast.Attribute) and node.attr != "UnpicklingError":  # which bad files raise
        return {ast.unparse(node.value)} & MODULES
    if isinstance(node, ast.ImportFrom):
        return {(node.module or "").split(".")[0]} & MODULES
    if not isinstance(node, ast.Call):
        return set()
    if isinstance(node.func, ast.Name):
        return {node.func.id} & CALLS
    given = {word.arg: ast.unparse(word.value) for word in node.keywords}
    return {"allow_pickle"} if given.get("allow_pickle", "False") != "False" else set()


def words_in(text: str) -> set[str]:
    """All of a program; a class that says itself which names a pickle may ask for (find_class) runs no others."""
    nodes = list(ast.walk(ast.parse(text)))
    says_which = [node for node in nodes if isinstance(node, ast.ClassDef) and "find_class" in map(name_of, node.body)]
    bases = [base for node in says_which for base in node.bases]
    return set().union(*(words(node) for node in nodes if node not in bases))


def name_of(node: ast.stmt) -> str:
    return node.name if isinstance(node, ast.FunctionDef) else ""


def test_nothing_runs_what_it_reads() -> None:
    files = sorted(file for part in ("edge", "edge_plugins", "sim") for file in (ROOT / part).rglob("*.py"))
    assert len(files) > 300
    for file in files:
        found = words_in(file.read_text(encoding="utf-8"))
        assert not found, f"{file.relative_to(ROOT)}: {found}"
