"""The container's file and its labels, which BlueOS reads, against the code that they describe."""

from __future__ import annotations

import hashlib
import json
import re
import stat
import subprocess
import sys
from pathlib import Path

import edge
from edge.config import DEFAULT_TOML, TelemetryConfig, load_config
from edge_plugins.page import PageConfig

CONTAINER = Path(__file__).parents[2] / "container"
DOCKERFILE = (CONTAINER / "Dockerfile").read_text().replace("\\\n", "")
UNIT = (CONTAINER.parent / "systemd/lookback.service").read_text()


def label(name: str) -> str:
    (value,) = re.findall(rf"^LABEL {name}=(['\"])(.*)\1$", DOCKERFILE, re.MULTILINE)
    return str(value[1])


def test_labels_are_json_and_name_this_version_and_port() -> None:
    permissions = json.loads(label("permissions"))
    port = f"{PageConfig().port}/tcp"
    assert list(permissions["ExposedPorts"]) == [port]
    assert permissions["HostConfig"]["PortBindings"] == {port: [{"HostPort": ""}]}
    assert not permissions["HostConfig"].get("Privileged")
    assert label("version") == edge.__version__
    assert all(isinstance(json.loads(label(name)), list) for name in ("authors", "tags"))
    assert f"EXPOSE {port}\n" in DOCKERFILE
    assert f"127.0.0.1:{PageConfig().port}/healthz" in DOCKERFILE


def test_what_is_copied_is_sent_to_the_builder_and_is_there() -> None:
    """The list of .dockerignore, which excludes all else."""
    root = CONTAINER.parent
    sent = set((root / ".dockerignore").read_text().split())
    lines = re.findall(r"^COPY (?!--from)(.*) \S+$", DOCKERFILE, re.MULTILINE)
    copied = {name for line in lines for name in line.split()}
    assert len(copied) > 8
    for name in copied:
        assert (root / name).exists()
        assert f"!{name.partition('/')[0]}" in sent


def test_every_package_of_the_wheel_is_installed_from_a_checkout() -> None:
    root = CONTAINER.parent
    (patterns,) = re.findall(r'packages.find\]\ninclude = \["(.*)"\]', (root / "pyproject.toml").read_text())
    names = [path.parent.name for one in patterns.split('", "') for path in root.glob(f"{one}/__init__.py")]
    assert {"edge", "edge_plugins", "lookback", "sim"} <= set(names)
    for file in ("systemd/install.sh", "tests/systemd/boot.sh", "container/Dockerfile"):
        words = (root / file).read_text().replace(";", " ").split()
        assert set(names) <= set(words), file


SCAN = [sys.executable, str(Path(__file__).with_name("scan_image.py"))]


def test_a_scan_finds_what_the_list_of_an_image_lacks(tmp_path: Path) -> None:
    """The release scans its image so: a package, a file of none, and a library of a wheel."""
    library, about = b"\x7fELF of a library", "opt/lookback/lib/python3.11/site-packages/lookback_nav-1.dist-info"
    for name, content in {
        "usr/lib/libc.so.6": library,
        "var/lib/dpkg/status": b"Package: libc6\nStatus: install ok installed\nArchitecture: amd64\nVersion: 2.36\n",
        "var/lib/dpkg/info/libc6:amd64.list": b"/.\n/lib/libc.so.6\n",
        f"{about}/METADATA": b"Metadata-Version: 2.1\nName: lookback-nav\nVersion: 1\n",
        f"{about}/RECORD": b"a.libs/libssl.so.3,,\n",
        f"{about}/../a.libs/libssl.so.3": library,
    }.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(content)
    (tmp_path / "lib").symlink_to("usr/lib")
    brought = {"type": "file", "name": "libssl", "hashes": [{"content": hashlib.sha256(library).hexdigest()}]}
    lookback = {"purl": "pkg:pypi/lookback-nav@1", "components": [brought]}
    bill = {"metadata": {"component": lookback}, "components": [{"purl": "pkg:deb/debian/libc6@2.36?arch=amd64"}]}

    def scanned() -> list[str]:
        (tmp_path / "opt/lookback/sbom.cdx.json").write_text(json.dumps(bill))
        done = subprocess.run([*SCAN, str(tmp_path)], capture_output=True, text=True, check=False)
        assert done.returncode == (not done.stdout.startswith("2 components, all in the list; 2 files")), done.stderr
        return done.stdout.splitlines()

    assert scanned() == ["2 components, all in the list; 2 files of code, each of a component"]
    bill["components"] = [{"purl": "pkg:pypi/gone@2"}]
    lookback["components"] = []
    (tmp_path / "opt/loose.py").write_text("")
    assert scanned() == [
        "not in the list: pkg:deb/debian/libc6@2.36?arch=amd64",
        "in the list, and not in the image: pkg:pypi/gone@2",
        "a library that a wheel brings along, and not in the list: "
        "/opt/lookback/lib/python3.11/site-packages/a.libs/libssl.so.3",
        "of no component: /opt/loose.py",
    ]


def test_the_environment_is_that_of_the_service() -> None:
    for word in re.findall(r"^Environment=(.*)$", UNIT, re.MULTILINE):
        assert set(word.split()) <= set(DOCKERFILE.split())


def test_the_generated_config_is_valid_and_reaches_the_host(tmp_path: Path) -> None:
    """The lines of `start` that edit the default config, run by sed."""
    start = (CONTAINER / "start").read_text()
    assert (CONTAINER / "start").stat().st_mode & stat.S_IXUSR
    script = re.findall(r"-e ('.*')", start)
    assert len(script) == 4
    command = f"sed {' '.join('-e ' + one for one in script)} {DEFAULT_TOML}"
    text = subprocess.run(["sh", "-c", command], capture_output=True, text=True, check=True).stdout
    (tmp_path / "lookback.toml").write_text(text)
    config = load_config(tmp_path / "lookback.toml")
    assert config.of(PageConfig).bind == "0.0.0.0"
    assert config.descriptor.model == "grid"
    assert "blueos.local" in config.of(PageConfig).hosts
    assert config.telemetry.connection.startswith("udp:host.docker.internal:")
    assert config.telemetry.journal == TelemetryConfig().journal
