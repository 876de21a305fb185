"""Updates of a running service by install.sh, in a mount namespace, with a small package and a made-up systemctl."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

pytestmark = pytest.mark.long

SYSTEMD = Path(__file__).parents[2] / "systemd"
MAIN = """import pathlib, sys
here = pathlib.Path(__file__).parent
sys.exit(78 if here.joinpath("REFUSES").exists() else 0)
"""
SYSTEMCTL = """#!/bin/sh
case "$*" in
    --version) echo "systemd 252 (252.1-1)" ;;
    "show -p MainPID --value lookback.service") cat "$STATE/pid" ;;
    "is-active --quiet lookback.service") [ "$(cat "$STATE/pid")" != 0 ] ;;
    "restart lookback.service") echo 200 >"$STATE/pid" ;;
esac
"""
SLEEP = """#!/bin/sh
for crash in /opt/lookback/lib/python3*/site-packages/edge/CRASHES; do [ ! -e "$crash" ] || echo 0 >"$STATE/pid"; done
"""
NAMESPACE = """set -e
mount --bind "$STATE/etc" /etc
mount --bind "$STATE/opt" /opt
mount --bind "$STATE/bin" /usr/local/bin
mount --bind "$STATE/run" /run
mount --bind "$PYTHON" "$STATE/python"  # the script takes none below /home or /root
exec "$@"
"""


@pytest.fixture
def system(tmp_path: Path, quick_python: Callable[..., Path]) -> Callable[..., subprocess.CompletedProcess[str]]:
    """Runs a command as root of a system of its own, of which `tmp_path` has the folders."""
    if subprocess.run(["unshare", "-rm", "true"], check=False, capture_output=True).returncode:
        pytest.skip("this user may not make a mount namespace")
    for folder in ("etc/systemd/system", "opt", "run/systemd/system", "programs", "python"):
        (tmp_path / folder).mkdir(parents=True)
    for file in ("passwd", "group", "ld.so.cache"):
        if Path("/etc", file).exists():
            shutil.copy(Path("/etc", file), tmp_path / "etc")
    shutil.copytree("/usr/local/bin", tmp_path / "bin", symlinks=True)
    (tmp_path / "pid").write_text("0\n")
    quick_python(tmp_path / "python3", tmp_path / "python/bin/python3")
    for name, text in (("systemctl", SYSTEMCTL), ("sleep", SLEEP), ("systemd-sysusers", ""), ("systemd-tmpfiles", "")):
        (tmp_path / "programs" / name).write_text(text or "#!/bin/sh\n")
        (tmp_path / "programs" / name).chmod(0o755)
    path = f"{tmp_path / 'programs'}:{os.environ['PATH']}"
    environment = {
        **os.environ,
        "STATE": str(tmp_path),
        "PYTHON": sys.base_prefix,
        "PATH": path,
        "PIP_NO_DEPS": "1",
        "PIP_NO_INDEX": "1",
    }

    def run(*command: str | Path) -> subprocess.CompletedProcess[str]:
        wrapped = ["unshare", "-rm", "sh", "-c", NAMESPACE, "sh", *map(str, command)]
        return subprocess.run(wrapped, env=environment, capture_output=True, text=True, check=False, cwd="/")

    return run


def wheel(folder: Path, version: str, *marks: str) -> Path:
    """A package that is Lookback for the script: what it says of a config, and whether its service crashes."""
    path, info = folder / f"lookback_nav-{version}-py3-none-any.whl", f"lookback_nav-{version}.dist-info"
    with zipfile.ZipFile(path, "w") as archive:
        for name, text in {
            "edge/__init__.py": f'__version__ = "{version}"\n',
            "edge/__main__.py": MAIN,
            "edge/start.toml": "",
            **{f"edge/{mark}": "" for mark in marks},
            f"{info}/METADATA": f"Metadata-Version: 2.1\nName: lookback-nav\nVersion: {version}\nProvides-Extra: oak\n"
            "Provides-Extra: fc6\nRequires-Dist: lookback-fc6; extra == 'fc6'\n",
            f"{info}/WHEEL": "Wheel-Version: 1.0\nGenerator: tests\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
            f"{info}/RECORD": "",
        }.items():
            archive.writestr(name, text)
    return path


def fc6_wheel(folder: Path) -> Path:
    """The network that was a part of Lookback, as a package of its own."""
    path, info = folder / "lookback_fc6-1.0-py3-none-any.whl", "lookback_fc6-1.0.dist-info"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("lookback_fc6/__init__.py", "")
        archive.writestr(f"{info}/METADATA", "Metadata-Version: 2.1\nName: lookback-fc6\nVersion: 1.0\n")
        archive.writestr(f"{info}/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n")
        archive.writestr(f"{info}/RECORD", "")
    return path


def version_of(root: Path) -> str:
    (file,) = root.glob("opt/lookback/lib/*/site-packages/edge/__init__.py")
    return file.read_text().split('"')[1]


def install(
    system: Callable[..., subprocess.CompletedProcess[str]], package: Path, *options: str, of: Path = SYSTEMD
) -> str:
    """What the script says, of its success or of its failure; without the locked packages, unless `of` has its own."""
    options = (*options, *["--newest"] * (of == SYSTEMD))
    done = system(of / "install.sh", "--wheel", package, "--python", package.parent / "python3", *options)
    return done.stdout if done.returncode == 0 else done.stderr


def test_a_version_that_does_not_run_is_taken_back(
    system: Callable[..., subprocess.CompletedProcess[str]], tmp_path: Path
) -> None:
    assert "Lookback is installed" in install(system, wheel(tmp_path, "1.0"))
    (tmp_path / "pid").write_text("100\n")  # an admin has started it
    unit = tmp_path / "etc/systemd/system/lookback.service"
    unit.write_text("of the old version")
    said = install(system, wheel(tmp_path, "2.0", "CRASHES"))
    assert "the new version did not run for a minute, so the old one is back" in said
    assert (version_of(tmp_path), unit.read_text()) == ("1.0", "of the old version")
    assert (tmp_path / "pid").read_text() == "200\n", "it was started again"
    assert "Lookback is updated" in install(system, wheel(tmp_path, "3.0"))
    assert version_of(tmp_path) == "3.0"
    assert [one.name for one in (tmp_path / "opt").iterdir()] == ["lookback"]


def test_a_version_that_refuses_the_config_is_not_installed(
    system: Callable[..., subprocess.CompletedProcess[str]], tmp_path: Path
) -> None:
    install(system, wheel(tmp_path, "1.0"))
    assert "the new version refuses the config, so the old one stays" in install(
        system, wheel(tmp_path, "2.0", "REFUSES")
    )
    assert version_of(tmp_path) == "1.0"
    (site,) = tmp_path.glob("opt/lookback/lib/*/site-packages/edge")
    (site / "REFUSES").touch()  # as where no map is built yet
    assert "Lookback is updated" in install(system, wheel(tmp_path, "2.0", "REFUSES"))


def test_the_extras_are_known_after_the_python_of_the_system_changed(
    system: Callable[..., subprocess.CompletedProcess[str]], tmp_path: Path
) -> None:
    install(system, wheel(tmp_path, "1.0"))
    (libraries,) = tmp_path.glob("opt/lookback/lib/python3*")
    libraries.rename(libraries.with_name("python3.9"))
    (tmp_path / "opt/lookback/bin/python3").unlink()
    assert "Lookback is updated, with the extras oak." in install(system, wheel(tmp_path, "2.0"))


def test_locked_packages_are_installed_by_their_hashes(
    system: Callable[..., subprocess.CompletedProcess[str]], tmp_path: Path
) -> None:
    scripts, whole = tmp_path / "systemd", tmp_path / "locked-1.0-py3-none-any.whl"
    shutil.copytree(SYSTEMD, scripts, ignore=shutil.ignore_patterns("lock"))
    (scripts / "lock").mkdir()
    (scripts / "lock/build.txt").touch()
    with zipfile.ZipFile(whole, "w") as archive:
        archive.writestr("locked.py", "")
        archive.writestr("locked-1.0.dist-info/METADATA", "Metadata-Version: 2.1\nName: locked\nVersion: 1.0\n")
        archive.writestr("locked-1.0.dist-info/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n")
        archive.writestr("locked-1.0.dist-info/RECORD", "")
    right = hashlib.sha256(whole.read_bytes()).hexdigest()
    for version, checksum in (("1.0", right), ("2.0", "0" * 64)):
        pin = f"--find-links {tmp_path}\nlocked==1.0 --hash=sha256:{checksum}\n"
        (scripts / "lock/core.txt").write_text(pin)
        said = install(system, wheel(tmp_path, version), "--extras", "none", of=scripts)
        assert ("Lookback is installed" if checksum == right else "DO NOT MATCH THE HASHES") in said
        assert version_of(tmp_path) == "1.0"
    assert list(tmp_path.glob("opt/lookback/lib/*/site-packages/locked.py"))


def test_a_package_that_was_removed_can_be_installed_again(
    system: Callable[..., subprocess.CompletedProcess[str]], tmp_path: Path
) -> None:
    """postrm has masked the unit; a unit of install.sh's is a file."""
    unit = tmp_path / "etc/systemd/system/lookback.service"
    unit.symlink_to("/dev/null")
    assert system(SYSTEMD / "deb/preinst", "install").returncode == 0
    unit.unlink()
    unit.touch()
    refused = system(SYSTEMD / "deb/preinst", "install")
    assert (refused.returncode, "install.sh has installed it here already" in refused.stderr) == (1, True)


def test_an_update_keeps_the_network_that_was_a_part_of_lookback(
    system: Callable[..., subprocess.CompletedProcess[str]], tmp_path: Path
) -> None:
    install(system, wheel(tmp_path, "1.0", "descriptor/models/alexnet_places100/fc6_int8.onnx"))
    assert "copy lookback_fc6-*.whl beside" in install(system, wheel(tmp_path, "2.0"))
    assert version_of(tmp_path) == "1.0"
    fc6_wheel(tmp_path)
    assert "Lookback is updated, with the extras oak,fc6." in install(system, wheel(tmp_path, "2.0"))
    assert list(tmp_path.glob("opt/lookback/lib/*/site-packages/lookback_fc6/__init__.py"))
    assert "Lookback is updated, with the extras oak,fc6." in install(system, wheel(tmp_path, "3.0")), "and again"
