"""ONNX Runtime must not phone home from a vehicle: a run leaves no file under HOME and connects to nothing.

Versions from 1.29 on do both within seconds unless told not to before the import. The same observation is made of a
process that does what they do, so that a blind observation fails here.
"""

from __future__ import annotations

import ast
import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

REPOSITORY = Path(__file__).parents[2]

DESCRIBE = """
import ctypes, numpy as np
from edge.descriptor.network import Network
network = Network.load()
network.describe(np.zeros((2, 224, 224, 3), np.uint8))
libc = ctypes.CDLL(None)
libc.getenv.restype = ctypes.c_char_p
assert libc.getenv(b"ORT_DISABLE_TELEMETRY") == b"1"
"""

PHONE_HOME = """
import pathlib, socket
cache = pathlib.Path.home() / ".cache" / "Microsoft"
cache.mkdir(parents=True)
(cache / "deviceid").write_text("0")
held = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
held.connect(("192.0.2.1", 443))  # TEST-NET-1: goes nowhere, and a datagram socket sends nothing to connect
"""

LIST_SOCKETS = """
import os
for fd in os.listdir("/proc/self/fd"):
    try:
        target = os.readlink(f"/proc/self/fd/{fd}")
    except OSError:
        continue
    if target.startswith("socket:"):
        print("held", target)
"""


@dataclass(frozen=True)
class Observed:
    """What a process left behind: files under its HOME, sockets held at its end, addresses it connected to."""

    files: list[str]
    sockets: list[str]
    addresses: list[str] | None


def observe(script: str, home: Path) -> Observed:
    """Run a script in its own process with an empty HOME; `addresses` is None where there is no strace."""
    home.mkdir()
    trace = home.with_suffix(".strace")
    strace = shutil.which("strace")
    watch = [strace, "-f", "-qq", "-e", "trace=connect,sendto,sendmsg,sendmmsg", "-o", str(trace)] if strace else []
    unset = ("XDG_CACHE_HOME", "XDG_CONFIG_HOME", "XDG_DATA_HOME", "XDG_STATE_HOME", "ORT_DISABLE_TELEMETRY")
    environment = {name: value for name, value in os.environ.items() if name not in unset}
    done = subprocess.run(
        [*watch, sys.executable, "-c", script + LIST_SOCKETS],
        cwd=REPOSITORY,
        env=environment | {"HOME": str(home), "PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    files = sorted(str(path.relative_to(home)) for path in home.rglob("*") if path.is_file())
    addresses = (
        re.findall(r'inet_addr\("([^"]+)"\)|inet_pton\(AF_INET6, "([^"]+)"', trace.read_text()) if strace else []
    )
    found = [v4 or v6 for v4, v6 in addresses if not (v4.startswith("127.") or v6 == "::1")]
    return Observed(files, done.stdout.split("\n")[:-1], found if strace else None)


def test_describing_leaves_nothing_and_connects_to_nothing(tmp_path: Path) -> None:
    observed = observe(DESCRIBE, tmp_path / "home")
    assert observed.files == []
    assert observed.sockets == []
    assert not observed.addresses


def test_the_observation_sees_a_process_that_phones_home(tmp_path: Path) -> None:
    observed = observe(PHONE_HOME, tmp_path / "home")
    assert observed.files == [".cache/Microsoft/deviceid"]
    assert len(observed.sockets) == 1
    assert observed.addresses in (None, ["192.0.2.1"])


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
