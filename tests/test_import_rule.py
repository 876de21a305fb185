"""Who may import whom: the folders of edge/ are stages that only recognizer, daemon and the commands join."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
STAGES = {"camera", "descriptor", "reference_map", "sequence", "telemetry"}
BELOW = {"edge.errors", "edge.config"}
PURE = {"descriptor", "reference_map", "sequence"}
JOINED = ("place_search", "map_scan", "map_part")


def imports(file: Path) -> set[str]:
    """Full names of all modules that a file imports, at any depth."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {name.name for name in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file}: relative import"
            found |= {node.module or ""} if node.module != "edge" else {f"edge.{name.name}" for name in node.names}
    return found


def ours(file: Path) -> set[str]:
    return {name for name in imports(file) if name.split(".")[0] in ("edge", "sim")}


def test_stages_import_only_themselves_and_what_is_below() -> None:
    for stage in STAGES:
        for file in (ROOT / "edge" / stage).rglob("*.py"):
            strangers = {name for name in ours(file) - BELOW if not name.startswith(f"edge.{stage}")}
            assert not strangers, f"{file.relative_to(ROOT)} imports {strangers}"


def test_errors_and_config_are_at_the_bottom() -> None:
    assert not ours(ROOT / "edge/errors.py")
    assert ours(ROOT / "edge/config.py") == {"edge.errors"}


def test_the_recognizer_and_its_search_join_pure_stages_only() -> None:
    allowed = (*(f"edge.{stage}" for stage in PURE), *(f"edge.{name}" for name in JOINED))
    for name in ("recognizer", *JOINED):
        strangers = {name for name in ours(ROOT / f"edge/{name}.py") - BELOW if not name.startswith(allowed)}
        assert not strangers, f"edge/{name}.py imports {strangers}"


def test_edge_never_imports_sim() -> None:
    for file in (ROOT / "edge").rglob("*.py"):
        assert not any(name.split(".")[0] == "sim" for name in imports(file)), file


def test_the_vehicle_never_loads_what_is_for_the_desk() -> None:
    """Heavy or foreign packages are imported where they are asked for, and pymavlink.mavutil nowhere in edge."""
    for file in (ROOT / "edge").rglob("*.py"):
        top = {
            name.name if isinstance(node, ast.Import) else node.module or ""
            for node in ast.parse(file.read_text(encoding="utf-8")).body
            if isinstance(node, ast.Import | ast.ImportFrom)
            for name in node.names
        }
        assert not {name.split(".")[0] for name in top} & {"onnx", "torch", "depthai", "panda3d", "scipy"}, file
        assert not any("mavutil" in name for name in imports(file)), file


def test_no_command_loads_what_only_another_needs() -> None:
    """All commands are put on one command line, and the daemon must not pay for the desk's packages."""
    program = (
        "import sys; from edge.__main__ import build_parser; build_parser();"
        "print(sorted({'matplotlib', 'panda3d', 'scipy', 'jinja2', 'onnx', 'depthai', 'torch'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_front_door_names_every_room() -> None:
    told = (ast.get_docstring(ast.parse((ROOT / "edge/__init__.py").read_text(encoding="utf-8"))) or "").replace(
        ",", " "
    )
    words = set(told.replace("(", " ").replace(")", " ").split())
    rooms = {file.stem for file in (ROOT / "edge").glob("*.py")} - {"__init__", "__main__"}
    assert rooms <= words, f"edge/__init__.py does not say what {rooms - words} are for"
