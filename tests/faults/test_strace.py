"""What a run does, as the kernel sees it: no connection off this machine, and no file outside its own folders."""

from __future__ import annotations

import os
import re
import shutil
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from edge.journal.records import PlaceFix
from sim.journal import records_of
from tests.common import PATIENCE_S

CALLS = (
    "connect,sendto,sendmsg,bind,openat,open,creat,mkdir,mkdirat,rename,renameat,renameat2,"
    "unlink,unlinkat,symlink,symlinkat,link,linkat,truncate"
)
WRITES = re.compile(r"O_WRONLY|O_RDWR|O_CREAT|O_TRUNC|O_APPEND")
QUOTED = re.compile(r'"((?:[^"\\]|\\.)*)"')
ADDRESS = re.compile(r'inet_addr\("([^"]+)"\)|inet_pton\(AF_INET6, "([^"]+)"')
DEVICES = ("/dev/null", "/dev/tty", "/dev/pts/", "/dev/shm/")


@pytest.fixture
def strace() -> str:
    program = shutil.which("strace")
    if program is None:
        pytest.skip("needs strace")
    return program


def test_what_a_run_touches(
    strace: str,
    calm_feed: Path,
    write_config: Callable[..., Path],
    start: Callable[..., Any],
    tmp_path: Path,
    tmp_path_factory: pytest.TempPathFactory,
    monkeypatch: pytest.MonkeyPatch,
    figures: Callable[[str], None],
) -> None:
    log, home = tmp_path_factory.mktemp("strace") / "log", tmp_path_factory.mktemp("home")
    config = write_config(camera={"device": str(calm_feed)}, page={"port": 0})
    environment = {"HOME": str(home), "PYTHONDONTWRITEBYTECODE": "1"}
    process = start(
        config, environment=environment, wrapper=[strace, "-f", "-qq", "-e", f"trace={CALLS}", "-o", str(log)]
    )
    if process.popen.poll() is not None and "ptrace" in process.told():
        pytest.skip("strace is not permitted here")
    process.wait_until_on_the_map()
    while len(list(records_of(tmp_path / "events.jsonl", PlaceFix))) < 12:
        process.wait_for_word("WATCHDOG=1")  # until there are statistics worth keeping
    (daemon,) = Path(f"/proc/{process.popen.pid}/task/{process.popen.pid}/children").read_text().split()
    os.kill(int(daemon), signal.SIGTERM)  # strace keeps signals to itself
    assert process.popen.wait(PATIENCE_S) == 0, process.told()
    lines = log.read_text(errors="replace").splitlines()
    assert any("events.jsonl" in line for line in lines), "the log shows the run"

    addresses = {first or second for line in lines for first, second in ADDRESS.findall(line)}
    assert {address for address in addresses if not address.startswith("127.") and address != "::1"} == set()

    notify = str(tmp_path_factory.getbasetemp())
    written: set[str] = set()
    for line in lines:
        call = line.split(maxsplit=1)[-1]
        if "= -1" in call or call.startswith(("connect", "send", "bind", "<...")):
            continue
        if call.startswith(("openat", "open(")) and not WRITES.search(call):
            continue
        written.update(QUOTED.findall(call))
    outside = {name for name in written if not name.startswith((str(tmp_path), *DEVICES))}
    sockets = {
        name for line in lines if "sun_path" in line for name in QUOTED.findall(line.partition("sun_path")[2])[:1]
    }
    figures(
        f"{len(lines)} calls; addresses {sorted(addresses)}; written: {sorted(Path(name).name for name in written)}"
    )
    assert outside == set()
    assert {Path(name).name for name in written} >= {"events.jsonl", "events.state"}
    assert {name for name in sockets if not name.startswith(notify)} == set()
    assert list(home.iterdir()) == []
