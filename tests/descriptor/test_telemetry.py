"""ONNX Runtime must not phone home from a vehicle, as versions from 1.29 on do unless told not to before the import.

What a run leaves under HOME and connects to is observed by `faults/test_strace.py`.
"""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

REPOSITORY = Path(__file__).parents[2]
DESCRIBE = """
import ctypes, numpy as np
from edge.descriptor.network import Network
Network.load().describe(np.zeros((2, 224, 224, 3), np.uint8))
libc = ctypes.CDLL(None)
libc.getenv.restype = ctypes.c_char_p
assert libc.getenv(b"ORT_DISABLE_TELEMETRY") == b"1"
"""


def test_describing_leaves_nothing_at_home(tmp_path: Path) -> None:
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("XDG_", "ORT_"))}
    environment = {**kept, "HOME": str(tmp_path), "PYTHONDONTWRITEBYTECODE": "1"}
    subprocess.run([sys.executable, "-c", DESCRIBE], cwd=REPOSITORY, env=environment, check=True)
    assert list(tmp_path.iterdir()) == []


def test_only_four_modules_import_onnx_runtime() -> None:
    """network.py sets the variable before its import; quantize.py, at a desk, imports network.py first."""
    found = {}
    for folder in ("edge", "edge_plugins", "sim"):
        for file in (REPOSITORY / folder).rglob("*.py"):
            names = [_imported(node) for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))]
            if any(name.split(".")[0] == "onnxruntime" for name in names):
                found[file.name] = names
    assert found.keys() == {"network.py", "quantize.py", "onnx_import.py", "foreign.py"}
    for name in ("quantize.py", "onnx_import.py"):
        assert "edge.descriptor.network" in found[name]


def _imported(node: ast.AST) -> str:
    """The module that a node imports; "" if it imports none."""
    if isinstance(node, ast.Import):
        return node.names[0].name
    return (node.module or "") if isinstance(node, ast.ImportFrom) else ""


def test_variable_is_set_before_the_import() -> None:
    lines = (REPOSITORY / "edge" / "descriptor" / "network.py").read_text(encoding="utf-8").splitlines()
    assert lines.index('os.environ["ORT_DISABLE_TELEMETRY"] = "1"') < lines.index("import onnxruntime")
