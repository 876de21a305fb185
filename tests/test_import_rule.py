"""Who may import whom: a frame goes through the stages of edge/ in one order, and none calls back."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from graphlib import CycleError, TopologicalSorter
from importlib import import_module
from pathlib import Path

import pytest

from tests.common import ROOT
from tests.imported import imports, is_module

STAGES = (
    "feed",
    "camera",
    "descriptor",
    "keypoints",
    "structure",
    "reference_map",
    "sequence",
    "localization",
    "telemetry",
    "health",
)
"""In the order of the data path: a stage may import itself, and the front door (`edge.STAGE`) of an earlier one.

Feeds come first, since one of the cameras plays a feed.
"""
PLUGINS = ("cameras", "motion", "layers", "mapping", "recording", "home", "ros2", "nmea", "page", "doctor")
"""A plug-in may import itself, those before it and all of edge."""
SHARED_TOOLS = (
    "errors",
    "config",
    "geodesy",
    "files",
    "backoff",
    "toml_file",
    "extras",
    "journal",
)
"""Below everything."""
DEBTS: set[tuple[str, str]] = set()
"""Imports that the rule forbids and that are still there; none may be added, and what is gone must be struck out."""
CIRCLE_DEBTS: set[tuple[str, str]] = set()
"""Imports without which there would be no circle; none may be added, and what is gone must be struck out."""


def ours(file: Path) -> set[str]:
    return {name for name in imports(file) if name.split(".")[0] in ("edge", "edge_plugins", "sim")}


def forbidden(stage: str) -> set[tuple[str, str]]:
    """Imports of a stage that are neither its own, nor shared tools, nor the front door of an earlier stage."""
    earlier = {f"edge.{name}" for name in STAGES[: STAGES.index(stage)]}
    found = set()
    for file in (ROOT / "edge" / stage).rglob("*.py"):
        for name in ours(file) - {"edge"}:
            parts = name.split(".")
            if parts[1] != stage and parts[1] not in SHARED_TOOLS and name not in earlier:
                found.add((f"{stage}.{file.stem}", name.removeprefix("edge.")))
    return found


def test_stages_import_only_themselves_shared_tools_and_the_front_doors_of_earlier_stages() -> None:
    found = {pair for stage in STAGES for pair in forbidden(stage)}
    assert not found - DEBTS, f"forbidden: {sorted(found - DEBTS)}"


def test_recognition_imports_no_stage_after_sequence() -> None:
    """It joins the stages up to there, and may import any file of theirs."""
    allowed = {*STAGES[: STAGES.index("sequence") + 1], *SHARED_TOOLS, "recognition"}
    for file in (ROOT / "edge/recognition").glob("*.py"):
        others = {name.split(".")[1] for name in ours(file)}
        assert others <= allowed, f"{file} imports {others - allowed}"


def test_shared_tools_import_only_shared_tools() -> None:
    allowed = {f"edge.{name}" for name in SHARED_TOOLS}
    for name in SHARED_TOOLS:
        file = ROOT / f"edge/{name}.py"
        assert not file.is_file() or ours(file) <= allowed, file


def test_edge_imports_neither_plugins_nor_sim() -> None:
    for file in (ROOT / "edge").rglob("*.py"):
        assert not any(name.split(".")[0] in ("edge_plugins", "sim") for name in imports(file)), file


def test_plugins_import_only_edge_and_the_plugins_before_them() -> None:
    for folder in (ROOT / "edge_plugins").glob("*/__init__.py"):
        name = folder.parent.name
        allowed = set(PLUGINS[: PLUGINS.index(name) + 1])
        for file in folder.parent.rglob("*.py"):
            others = {one.split(".")[1] for one in ours(file) if one.startswith("edge_plugins.")}
            assert others <= allowed, f"{file} imports {others - allowed}"
            assert not any(one.split(".")[0] == "sim" for one in ours(file)), file


def test_what_is_in_the_wheel_never_imports_research() -> None:
    for file in (ROOT / "sim").rglob("*.py"):
        if "research" not in file.parts:
            assert not any(name.startswith("sim.research") for name in imports(file)), file


def test_the_vehicle_never_loads_what_is_for_the_desk() -> None:
    """Heavy or foreign packages are imported where they are asked for, and pymavlink.mavutil nowhere in edge."""
    for file in [*(ROOT / "edge").rglob("*.py"), *(ROOT / "edge_plugins").rglob("*.py")]:
        top = {
            name.name if isinstance(node, ast.Import) else node.module or ""
            for node in ast.parse(file.read_text(encoding="utf-8")).body
            if isinstance(node, ast.Import | ast.ImportFrom)
            for name in node.names
        }
        assert not {name.split(".")[0] for name in top} & {"onnx", "torch", "depthai", "panda3d"}, file
        assert not any("mavutil" in name for name in imports(file)), file


@pytest.mark.parametrize(
    ("words", "absent"),
    [
        ([], {"numpy", "cv2", "onnxruntime", "pymavlink", "serial"}),
        (["run", "lookback.toml"], {"matplotlib", "panda3d", "jinja2", "onnx", "depthai", "torch", "sim"}),
        (None, {"matplotlib", "panda3d", "jinja2", "onnx", "depthai", "torch"}),
    ],
    ids=["help", "run", "all"],
)
def test_no_command_loads_what_only_another_needs(words: list[str] | None, absent: set[str]) -> None:
    """Help is shown at once, and the daemon must not pay for the desk's packages."""
    program = (
        "import sys; from edge.__main__ import build_parser;"
        f"build_parser({words!r}); print(sorted({absent!r} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_every_module_of_a_vehicle_can_be_imported() -> None:
    """Also on a Python for which a package of an extra is missing: it is asked for only when it is used."""
    for file in [*(ROOT / "edge").rglob("*.py"), *(ROOT / "edge_plugins").rglob("*.py")]:
        module = ".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        import_module(module)


@pytest.mark.parametrize("package", ["edge", "edge_plugins"])
def test_the_front_door_names_every_room(package: str) -> None:
    doc = ast.get_docstring(ast.parse((ROOT / package / "__init__.py").read_text(encoding="utf-8"))) or ""
    words = {word.strip("`,:;./()") for word in doc.split()}
    rooms = {file.stem for file in (ROOT / package).glob("*.py")} - {"__init__", "__main__"}
    rooms |= {folder.parent.name for folder in (ROOT / package).glob("*/__init__.py")}
    assert rooms <= words, f"{package}/__init__.py does not say what {rooms - words} are for"


def import_graph() -> dict[str, set[str]]:
    """Every module with those that it names in an import, also for types alone or inside a function.

    That Python imports `edge.camera` before `edge_plugins.cameras.oak` is no import of ours, and is not counted.
    """
    files = [file for package in ("edge", "edge_plugins", "sim") for file in (ROOT / package).rglob("*.py")]
    return {module_name(file): {name for name in ours(file) if is_module(name)} for file in files}


def module_name(file: Path) -> str:
    return ".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


def circle(graph: dict[str, set[str]]) -> list[str]:
    """A circle of imports, its first module again at its end; empty if there is none."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return list(reversed(error.args[1]))
    return []


def test_there_is_no_import_circle() -> None:
    graph = import_graph()
    assert len(graph) > 150
    for importer, imported in CIRCLE_DEBTS:
        assert imported in graph.get(importer, set()), f"strike out {importer} -> {imported}: it is gone"
        graph[importer].remove(imported)
    assert not circle(graph), " -> ".join(circle(graph))
    for importer, imported in CIRCLE_DEBTS:
        assert circle({**graph, importer: {*graph[importer], imported}}), f"strike out {importer} -> {imported}"


def test_the_tests_mirror_the_program() -> None:
    """Each folder of tests is that of a package, or of what has no package."""

    def folders(path: Path) -> set[str]:
        return {folder.name for folder in path.iterdir() if list(folder.glob("*.py"))}

    beside = {
        "docs",
        "faults",
        "firmware_config",
        "golden",
        "guard",
        "hardware",
        "lookback",
        "plugins",
        "sim",
        "systemd",
    }
    assert folders(ROOT / "tests") - beside <= folders(ROOT / "edge")
    assert folders(ROOT / "tests/sim") <= folders(ROOT / "sim")
    assert folders(ROOT / "tests/plugins") <= folders(ROOT / "edge_plugins")
    modules = {f"test_{file.stem.strip('_')}" for file in (ROOT / "edge").glob("*.py")}
    whole = {"test_budget", "test_import_rule", "test_one_frame"}
    for file in (ROOT / "tests").glob("test_*.py"):
        assert file.stem in whole or any(file.stem.startswith(module) for module in modules - {"test_init"}), file


OPENED = """
import sys
from contextlib import ExitStack, suppress
from pathlib import Path
from edge.camera import open_camera
from edge.commands import run
from edge.config import load_config
from edge.errors import LookbackError
from edge.opened_parts import OpenedParts
config = load_config(Path(sys.argv[1]))
with ExitStack() as parts:
    with suppress(LookbackError):
        OpenedParts(config, parts)
    with suppress(LookbackError):
        open_camera(config.camera)
for name, module in sorted(sys.modules.items()):
    if name.split(".")[0] in ("edge", "edge_plugins", "sim") and module.__file__:
        print(len(Path(module.__file__).read_text(encoding="utf-8").splitlines()), name)
"""
"""Opens what the daemon opens, also where no map and no camera is there."""
REPORT_LINES_MOST = 19_180
"""Of these, 90 say by what the vehicle steers, 300 judge a GPS that the
vehicle follows, or that is jammed, 190 believe a place with where GPS and odometry have the vehicle, 40 count what
GPS has no part in, 60 take a wrong GPS from PX4, 35 end the command of a camera, 15 offer the stage of keypoints a
network, 20 keep the points that a page draws, 110 open a map that has them, 10 one of this drive, 180 ask what its
keyframes say, 230 put what one picture sees of it on the ground, 40 read a camera's lens, 25 follow a drive beside GPS,
300 move the vehicle by its gyros, and 310 bound the autopilot by what GPS has shown of the wheels,
and 40 give a PX4 its origin at a place."""


def lines_loaded(config: Path) -> dict[str, int]:
    """The lines of each module of ours that a daemon with this config loads."""
    words = [sys.executable, "-c", OPENED, str(config)]
    done = subprocess.run(words, capture_output=True, text=True, check=True, cwd=config.parent)
    return {name: int(count) for count, _, name in (line.partition(" ") for line in done.stdout.splitlines())}


def test_a_vehicle_loads_what_its_config_names_and_no_more(tmp_path: Path) -> None:
    """emit = "report" and no plug-in; each plug-in where its section asks for it."""
    config = tmp_path / "lookback.toml"
    least = (
        '[camera]\ndevice = "none"\n[map]\npath = "none"\n[telemetry]\nconnection = "udp:127.0.0.1:9"\njournal = ""\n'
    )
    (tmp_path / "none").mkdir()
    (tmp_path / "none/map.json").touch()
    config.write_text(f"{least}[page]\nport = 0\n", encoding="utf-8")
    lines = lines_loaded(config)
    print(sum(lines.values()), "lines")
    assert {"edge.camera.v4l2", "edge.telemetry.autopilot", "edge.recognition.recognizer"} <= set(lines)
    assert not [name for name in lines if name.startswith("edge_plugins.") and name.count(".") > 1]
    assert sum(lines.values()) < REPORT_LINES_MOST
    of_camera = least.replace("[map]", "fov_deg = 80.0\n[map]")
    config.write_text(f'{of_camera}[motion]\nuse = "report"\n[page]\nport = 0\n', encoding="utf-8")
    assert {name for name in lines_loaded(config) if name.endswith(".plugin")} == {
        "edge.plugin",
        "edge_plugins.motion.plugin",
    }


def test_make_names_tests_that_exist() -> None:
    """Pytest ignores a file that has moved without a word."""
    command = ["make", "--dry-run", "test-core", "test-python", "test-kernels"]
    said = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    named = set(re.findall(r"\btests/[\w/]+(?:\.py)?", said))
    assert len(named) > 30
    assert not [name for name in named if not (ROOT / name).exists()]
