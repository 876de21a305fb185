"""docs/fleet.md's own package repository: its files and its command, run by reprepro, gpg and apt."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

FLEET = (Path(__file__).parents[2] / "docs/fleet.md").read_text(encoding="utf-8")
TOOLS = ("reprepro", "gpg", "gpgconf", "apt-get", "dpkg-deb")
pytestmark = pytest.mark.skipif(None in map(shutil.which, TOOLS), reason=f"needs {', '.join(TOOLS)}")


def block(first_word: str) -> str:
    """The text in FLEET's fences that begins with this word."""
    (text,) = re.findall(rf"```text\n({first_word}.*?)```", FLEET, re.DOTALL)
    return str(text)


@pytest.fixture
def keys() -> Iterator[dict[str, str]]:
    """An environment with a new key of the company's; in a short path, since gpg-agent listens at a socket in it."""
    with tempfile.TemporaryDirectory() as home:
        environment = {**os.environ, "GNUPGHOME": home}
        who = ("Your Company <ops@your.company>", "default", "default", "never")
        subprocess.run(["gpg", "--batch", "--passphrase", "", "--quick-gen-key", *who], env=environment, check=True)
        yield environment
        subprocess.run(["gpgconf", "--kill", "all"], env=environment, check=True)


def apt(vehicle: Path, tool: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Of a vehicle that has this folder for its root."""
    command = [tool, f"-oDir={vehicle}", "-oAPT::Sandbox::User=root", *arguments]
    environment = {**os.environ, "LC_ALL": "C"}
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


def test_a_vehicle_finds_the_package_in_a_repository_of_ones_own(keys: dict[str, str], tmp_path: Path) -> None:
    control = "Package: lookback\nVersion: 0.3.0\nArchitecture: amd64\nMaintainer: A <a@b.c>\nDescription: a test\n"
    (tmp_path / "stage/DEBIAN").mkdir(parents=True)
    (tmp_path / "stage/DEBIAN/control").write_text(f"{control}Section: science\nPriority: optional\n")
    (tmp_path / "dist").mkdir()
    subprocess.run(["dpkg-deb", "--build", tmp_path / "stage", tmp_path / "dist"], check=True)
    served = tmp_path / "apt"
    (served / "conf").mkdir(parents=True)
    (served / "conf/distributions").write_text(block("Codename"))
    (command,) = (line for line in block("systemd/build-deb.sh").splitlines() if line.startswith("reprepro"))
    subprocess.run(command.replace("/srv/apt", str(served)), shell=True, cwd=tmp_path, env=keys, check=True)

    vehicle = tmp_path / "vehicle"
    for name in ("sources.list.d", "preferences.d", "apt.conf.d", "trusted.gpg.d", "keyrings"):
        (vehicle / "etc/apt" / name).mkdir(parents=True)
    for name in ("lib/apt/lists/partial", "cache/apt/archives/partial", "lib/dpkg"):
        (vehicle / "var" / name).mkdir(parents=True)
    (vehicle / "var/lib/dpkg/status").touch()
    text = block("Types").replace("https://apt.your.company", f"file://{served}")
    (vehicle / "etc/apt/sources.list.d/lookback.sources").write_text(text.replace("/etc/", f"{vehicle}/etc/"))
    assert "is not signed" in apt(vehicle, "apt-get", "update").stderr, "it has no key yet"
    (export,) = re.findall(r"`(gpg --armor --export [^`]*)`", FLEET)
    key = vehicle / "etc/apt/keyrings/your-company.asc"
    key.write_bytes(subprocess.run(export.split(), env=keys, capture_output=True, check=True).stdout)
    done = apt(vehicle, "apt-get", "update", "--error-on=any")
    assert done.returncode == 0, done.stderr
    assert "Candidate: 0.3.0\n" in apt(vehicle, "apt-cache", "policy", "lookback").stdout
