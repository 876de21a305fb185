"""Every path of a config, leading where the service may not or cannot read: exit 78 and one line, never a restart.

As root the daemon runs without capabilities, as the service does; otherwise root could read everything.
"""

from __future__ import annotations

import json
import os
import select
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from edge.config import CameraConfig, Config, DescriptorConfig, LinkConfig, MapConfig, TelemetryConfig, change_paths
from edge.errors import EXIT_SETUP
from edge.extras import install_command
from edge_plugins.recording import RecordingConfig
from tests.common import PATIENCE_S

WITHOUT_RIGHTS = ["setpriv", "--bounding-set=-all", "--inh-caps=-all", "--no-new-privs"]
LINK = {"connection": "udp:127.0.0.1:9"}


def setting(key: str, path: Path) -> dict[str, dict[str, Any]]:
    """The sections of a config in which the key is that path."""
    section, name = key.strip("[").split("] ")
    if section == "telemetry.links":
        return {"telemetry": {"links": [{**LINK, name: str(path)}]}}
    extra = {"kind": "feed"} if key == "[camera] device" else {}
    return {section: {name: str(path), **extra}}


def all_keys() -> list[str]:
    """Of everything that a config can name on the disk, as the code that reads configs knows it."""
    config = Config(
        camera=CameraConfig(kind="feed", mask="m"),
        descriptor=DescriptorConfig(model="m"),
        map=MapConfig(require_signature_by="k"),
        telemetry=TelemetryConfig(signing_key="k", links=(LinkConfig("udp:127.0.0.1:9", "k"),)),
        plugins={"recording": RecordingConfig(folder="f")},
    )
    keys: list[str] = []

    def keep(where: str, path: str) -> str:
        keys.append(where)
        return path

    change_paths(config, keep)
    return keys


FORKS = """
import json, os, sys
import edge.commands.run, sim.maps.command  # once, not in each of the tests
from edge.__main__ import main
for line in sys.stdin:
    says, without, *words = json.loads(line)
    child = os.fork()
    if child == 0:
        os.dup2(os.open(says, os.O_WRONLY | os.O_CREAT), sys.stderr.fileno())
        sys.modules.update({without: None} if without else {})
        os._exit(main(words))
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""
Refused = Callable[..., str]


@pytest.fixture(scope="module")
def refused(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Refused]:
    """Runs the daemon as the service's user would, perhaps without a package; its one line."""
    if os.geteuid() == 0 and shutil.which("setpriv") is None:
        pytest.skip("root needs setpriv (util-linux) to run without capabilities")
    wrapper = WITHOUT_RIGHTS if os.geteuid() == 0 else []
    command = [*wrapper, sys.executable, "-c", FORKS]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as service:
        assert service.stdin is not None and service.stdout is not None
        requests, answers, said = service.stdin, service.stdout, tmp_path_factory.mktemp("said")

        def run(config: Path, without: str = "", command: tuple[str, ...] = ("run",)) -> str:
            file = said / f"{len(list(said.iterdir()))}"
            requests.write(json.dumps([str(file), without, *command, str(config)]) + "\n")
            requests.flush()
            assert select.select([answers], [], [], PATIENCE_S)[0], "it does not end"
            assert int(answers.readline()) == EXIT_SETUP, file.read_text()
            (line,) = file.read_text().splitlines()
            return line

        yield run
        requests.close()


@pytest.fixture
def closed(tmp_path: Path) -> Any:
    folder = tmp_path / "closed"
    folder.mkdir()
    (folder / "inside").mkdir()
    folder.chmod(0)
    yield folder
    folder.chmod(0o700)


def test_all_keys_are_known() -> None:
    assert len(all_keys()) == 10


@pytest.mark.parametrize("key", all_keys())
def test_below_a_folder_that_is_closed(
    key: str, closed: Path, write_config: Callable[..., Path], refused: Refused
) -> None:
    line = refused(write_config(**setting(key, closed / "inside")))
    assert f"{key}: {closed / 'inside'}: this user may not enter {closed}" in line


@pytest.mark.parametrize("key", [key for key in all_keys() if key != "[telemetry] journal"])
def test_a_named_pipe(key: str, tmp_path: Path, write_config: Callable[..., Path], refused: Refused) -> None:
    """It would be read without end, before the service is ready."""
    os.mkfifo(tmp_path / "pipe")
    assert f"{key}: {tmp_path / 'pipe'}: neither a file nor a folder" in refused(
        write_config(**setting(key, tmp_path / "pipe"))
    )


@pytest.mark.parametrize("key", [key for key in all_keys() if "journal" not in key and "clock" not in key])
def test_a_file_that_others_own(key: str, tmp_path: Path, write_config: Callable[..., Path], refused: Refused) -> None:
    (tmp_path / "file").touch(mode=0)
    assert f"{key}: {tmp_path / 'file'}: this user may not read it" in refused(
        write_config(**setting(key, tmp_path / "file"))
    )


def test_a_closed_path_on_the_command_line(closed: Path, tmp_path: Path, refused: Refused) -> None:
    line = refused(closed / "inside", command=("map", "build", "-o", str(tmp_path / "map")))
    assert line == f"lookback: {closed / 'inside'}: Permission denied"


def test_a_home_folder_is_what_the_service_does_not_see(write_config: Callable[..., Path]) -> None:
    if shutil.which("unshare") is None or os.geteuid() != 0:
        pytest.skip("needs unshare (util-linux) and root, to close /home as ProtectHome=yes does")
    config = write_config(map={"path": "/home/pi/street.map"})
    script = 'mount -t tmpfs -o mode=0 tmpfs /home && exec "$@"'
    command = ["unshare", "--mount", "sh", "-c", script, "sh", *WITHOUT_RIGHTS, sys.executable, "-m", "edge", "run"]
    result = subprocess.run([*command, str(config)], capture_output=True, text=True, check=False, timeout=PATIENCE_S)
    if "mount" in result.stderr:
        pytest.skip(f"may not mount here: {result.stderr.strip()}")
    assert result.returncode == EXIT_SETUP
    (line,) = result.stderr.splitlines()
    assert line.startswith(f"lookback: {config}: [map] path: /home/pi/street.map: this user may not enter /home; ")
    assert "ProtectHome" in line
    assert "/var/lib/lookback" in line


def test_signed_maps_without_their_extra(tmp_path: Path, write_config: Callable[..., Path], refused: Refused) -> None:
    (tmp_path / "owner.pub").write_text(f"{'0' * 64}\n")
    line = refused(write_config(map={"require_signature_by": "owner.pub"}), without="cryptography")
    assert line == f"lookback: signed maps need the package cryptography: {install_command('signing')}"
