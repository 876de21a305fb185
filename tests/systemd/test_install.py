"""install.sh and build-deb.sh, run for real below a folder of their own.

The package goes in without its dependencies (PIP_NO_DEPS), which pip would download: half a gigabyte of other
people's files say nothing about the scripts. Building the package still takes setuptools from a package index.
"""

from __future__ import annotations

import json
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable
from importlib.metadata import distributions, version
from pathlib import Path

import msgspec
import pytest
from packaging.requirements import Requirement

import edge

pytestmark = pytest.mark.long

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

SYSTEMD = Path(__file__).parents[2] / "systemd"
INSTALL = SYSTEMD / "install.sh"
BUILD_DEB = SYSTEMD / "build-deb.sh"
START_TOML = Path("edge/start.toml")
CONFIG = Path("etc/lookback/lookback.toml")
UNIT = Path("etc/systemd/system/lookback.service")


IS_LEFT_OUT = re.compile(r"sim/|edge/\w+/")
"""Of a wheel: the scripts do the same with a package of few files."""


# Notes each process that compileall starts: forked by itself, or by the server that forks for it from Python 3.14 on.
NOTES_COMPILERS = """import os, sys
if {"compileall", "--multiprocessing-fork"} & set(sys.orig_argv) or "multiprocessing.forkserver" in str(sys.orig_argv):
    os.register_at_fork(after_in_child=lambda: open(os.environ["COMPILERS"], "a").write(f"{os.getpid()}\\n"))
"""


def run(
    script: Path, *arguments: str | Path, systemd: int = 252, compilers: Path = Path(os.devnull)
) -> subprocess.CompletedProcess[str]:
    """Run a script on a system whose systemd has this version; below a folder it asks for nothing else of it."""
    with tempfile.TemporaryDirectory() as programs:
        systemctl = Path(programs, "systemctl")
        systemctl.write_text(f'#!/bin/sh\n[ "$*" = --version ] && echo "systemd {systemd} ({systemd}.1-1)"\n')
        systemctl.chmod(0o755)
        Path(programs, "sitecustomize.py").write_text(NOTES_COMPILERS)
        environment = {**os.environ, "PIP_NO_DEPS": "1", "PATH": f"{programs}:{os.environ['PATH']}"}
        environment |= {"PYTHONPATH": programs, "COMPILERS": str(compilers), "DPKG_DEB_COMPRESSOR_LEVEL": "0"}
        installs = script.name in (INSTALL.name, BUILD_DEB.name) and not {"--uninstall", "--help"} & set(arguments)
        # What is locked would be downloaded.
        command = [str(script), *["--newest"] * installs, *map(str, arguments)]
        return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def wheel(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel without `sim` and the folders of `edge`, whose 350 files each installation would compile."""
    small = tmp_path_factory.mktemp("small") / wheel.name
    with zipfile.ZipFile(wheel) as whole, zipfile.ZipFile(small, "w") as part:
        for name in whole.namelist():
            if not IS_LEFT_OUT.match(name):
                lines = whole.read(name).decode().splitlines(keepends=True)
                kept = [line for line in lines if not IS_LEFT_OUT.match(line)] if name.endswith("RECORD") else lines
                part.writestr(name, "".join(kept))
    return small


@pytest.fixture
def python(quick_python: Callable[..., Path], tmp_path: Path) -> Path:
    return quick_python(tmp_path / "python3")


@pytest.fixture(scope="module")
def installed(wheel: Path, make_once: Callable[..., Path]) -> Path:
    """Lookback installed once below `root`, and `compilers`: the processes that compiled it."""

    def first(folder: Path) -> None:
        arguments = ("--root", folder / "root", "--wheel", wheel, "--python", sys.executable)
        result = run(INSTALL, *arguments, compilers=folder / "compilers")
        assert "with the extras page, and starts at boot" in result.stdout, result.stderr

    return make_once("installed", first)


@pytest.fixture(scope="module")
def root(installed: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A system with Lookback installed; no test leaves it changed."""
    return shutil.copytree(installed / "root", tmp_path_factory.mktemp("system") / "root", symlinks=True)


def files_under(root: Path) -> dict[str, tuple[int, bytes]]:
    """Path, mode and content of every file that is not inside the virtual environment's libraries."""
    paths = [path for path in root.rglob("*") if path.is_file() and "lib" not in path.relative_to(root).parts]
    return {str(path.relative_to(root)): (path.stat().st_mode, path.read_bytes()) for path in paths}


def test_puts_every_file_in_its_place(root: Path, checkout: Path) -> None:
    found = set(files_under(root))
    assert {
        str(CONFIG),
        str(UNIT),
        "etc/systemd/system/lookback-camera.socket",
        "etc/systemd/system/lookback-camera@.service",
        "etc/sysusers.d/lookback.conf",
        "etc/tmpfiles.d/lookback.conf",
        "etc/udev/rules.d/70-lookback.rules",
        "opt/lookback/bin/lookback",
    } <= found
    assert (root / "usr/local/bin/lookback").readlink() == Path("/opt/lookback/bin/lookback")
    assert not (root / "etc/systemd/system/lookback.service.d").exists()  # systemd 252 knows no RestartSteps=
    assert (root / CONFIG).read_bytes() == (checkout / START_TOML).read_bytes()
    assert (root / CONFIG).stat().st_mode & 0o777 == 0o640


def test_the_environment_is_at_home_in_opt(root: Path) -> None:
    """It was built elsewhere, and no path in it may say so."""
    venv = root / "opt/lookback"
    assert (venv / "bin/lookback").read_text().splitlines()[0] == "#!/opt/lookback/bin/python"
    for file in [venv / "pyvenv.cfg", *(path for path in (venv / "bin").iterdir() if not path.is_symlink())]:
        assert str(root) not in file.read_text(), file
    command = [str(venv / "bin/python"), "-c", "from importlib.metadata import version; print(version('lookback-nav'))"]
    result = subprocess.run(command, capture_output=True, text=True, check=True)
    assert result.stdout.strip() == edge.__version__
    assert list((venv / "lib").rglob("edge/__pycache__/daemon.*.pyc"))


def test_every_core_compiles(installed: Path) -> None:
    """On a board the modules compile for minutes by one process."""
    assert len(set((installed / "compilers").read_text().split())) >= min(2, os.cpu_count() or 1)


def test_the_unit_starts_what_was_installed(root: Path) -> None:
    line = next(line for line in (root / UNIT).read_text().splitlines() if line.startswith("ExecStart="))
    program, _, config = line.removeprefix("ExecStart=").split()
    assert (root / program.lstrip("/")).is_file()
    assert (root / config.lstrip("/")).is_file()


def test_again_from_the_checkout_changes_nothing(root: Path, checkout: Path, python: Path, tmp_path: Path) -> None:
    """The config is the admin's by now; and nothing is left in the checkout."""
    folders = [
        path.name
        for package in ("edge", "edge_plugins", "sim")
        for path in (checkout / package).iterdir()
        if path.is_dir()
    ]
    checkout = shutil.copytree(checkout, tmp_path / "checkout", ignore=shutil.ignore_patterns(*folders))
    (root / CONFIG).write_text("[camera]\nkind = 'oak'\n")
    before, before_there = files_under(root), set(checkout.rglob("*"))
    result = run(checkout / "systemd" / INSTALL.name, "--root", root, "--python", python)
    assert result.returncode == 0, result.stderr
    assert files_under(root) == before
    assert set(checkout.rglob("*")) == before_there
    shutil.copy(checkout / START_TOML, root / CONFIG)


@pytest.mark.parametrize(
    ("version", "why"),
    [
        ("3.9", "is Python 3.9, and Lookback needs 3.10 to 3.14; name one with --python"),
        ("3.14", "has no venv: apt install python3.14-venv"),
    ],
)
def test_a_python_that_does_not_do_is_named(version: str, why: str, tmp_path: Path) -> None:
    python = tmp_path / "python3"
    python.write_text(f"#!/bin/sh\n[ \"$2\" = 'import ensurepip, venv' ] && exit 1\necho {version}\n")
    python.chmod(0o755)
    result = run(INSTALL, "--root", tmp_path / "root", "--python", python)
    assert result.stderr == f"install.sh: {python} {why}\n"


def pretend_to_install(root: Path, *distributions: str) -> None:
    """What pip leaves of a package: tests install none."""
    site = next((root / "opt/lookback/lib").glob("*/site-packages"))
    for name in distributions:
        info = site / f"{name.replace('-', '_')}-99.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 99.0\n")


@pytest.mark.parametrize(
    ("options", "extras"),
    [(["--extras", "oak,page"], "page,signing,oak"), (["--extras", "none"], "")],
)
def test_an_update_keeps_the_extras(
    options: list[str], extras: str, root: Path, wheel: Path, python: Path, tmp_path: Path
) -> None:
    root = shutil.copytree(root, tmp_path / "root", symlinks=True)
    pretend_to_install(root, "prometheus-client", "starlette", "uvicorn", "cryptography")
    result = run(INSTALL, "--root", root, "--wheel", wheel, "--python", python, *options)
    assert result.returncode == 0, result.stderr
    named = sorted(result.stdout.removeprefix("Lookback is updated, with the extras ").rstrip(".\n").split(","))
    assert named == (sorted(extras.split(",")) if extras else ["Lookback is updated"])


def test_a_failed_update_leaves_the_old_version_and_cleans_up_after_a_killed_one(
    root: Path, python: Path, tmp_path: Path
) -> None:
    root = shutil.copytree(root, tmp_path / "root", symlinks=True)
    before = files_under(root)
    (root / "opt/lookback.new.Ab3dE6/venv").mkdir(parents=True)
    (root / "opt/lookback").rename(root / "opt/lookback.old")  # killed between the two renames
    (root / "opt/lookback.backup").mkdir()
    broken = tmp_path / f"lookback_nav-{edge.__version__}-py3-none-any.whl"
    broken.write_bytes(b"not a wheel")
    assert run(INSTALL, "--root", root, "--wheel", broken, "--python", python).returncode != 0
    assert sorted(path.name for path in (root / "opt").iterdir()) == ["lookback", "lookback.backup"]
    shutil.rmtree(root / "opt/lookback.backup")
    assert files_under(root) == before


def test_a_program_of_another_name_stays(wheel: Path, python: Path, tmp_path: Path) -> None:
    program = tmp_path / "root/usr/local/bin/lookback"
    program.parent.mkdir(parents=True)
    program.write_text("mine")
    result = run(INSTALL, "--root", tmp_path / "root", "--wheel", wheel, "--python", python)
    assert result.returncode == 0
    assert "belongs to something else" in result.stderr
    assert run(INSTALL, "--uninstall", "--root", tmp_path / "root").returncode == 0
    assert program.read_text() == "mine"


def test_uninstall_keeps_what_is_the_users_and_purge_does_not(root: Path, tmp_path: Path) -> None:
    root = shutil.copytree(root, tmp_path / "root", symlinks=True)
    state = root / "var/lib/lookback/events.jsonl"
    state.parent.mkdir(parents=True)
    state.write_text("{}\n")
    for _ in range(2):
        assert run(INSTALL, "--uninstall", "--root", root).returncode == 0
        assert {path for path in root.rglob("*") if path.is_file()} == {root / CONFIG, state}
    assert run(INSTALL, "--uninstall", "--purge", "--root", root).returncode == 0
    assert [path for path in root.rglob("*") if path.is_file()] == []


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--root", "x", "--python", "nopy"], "nopy: no such program; install it: apt install python3 python3-venv"),
        (["--frobnicate"], "unknown option --frobnicate; see --help"),
        (["--purge"], "--purge goes with --uninstall"),
        (["--wheel"], "--wheel needs a value; see --help"),
        (["--wheel", "missing.whl"], "missing.whl: no such file"),
        (["--root", "x", "--python", "/bin/false"], "/bin/false does not run as Python"),
    ],
)
def test_bad_arguments(arguments: list[str], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    result = run(INSTALL, *arguments)
    assert (result.returncode, result.stderr) == (1, f"install.sh: {message}\n")


def test_deb_carries_it_all(wheel: Path, checkout: Path, python: Path, tmp_path: Path) -> None:
    if shutil.which("dpkg-deb") is None:
        pytest.skip("needs dpkg-deb")
    who = "Example <ops@example.com>"
    result = run(BUILD_DEB, "-o", tmp_path, "--maintainer", who, "--wheel", wheel, "--python", python, systemd=255)
    assert result.returncode == 0, result.stderr
    (package,) = tmp_path.glob("*.deb")
    unpacked = tmp_path / "unpacked"
    subprocess.run(["dpkg-deb", "--raw-extract", package, unpacked], check=True)
    control = (unpacked / "DEBIAN/control").read_text()
    minor = sys.version_info.minor
    assert f"Version: {edge.__version__.replace('.dev', '~dev')}\n" in control
    assert f"Maintainer: {who}\n" in control
    site = next(unpacked.glob("opt/lookback/lib/python3*/site-packages"))
    assert not [name for name in ("pip", "setuptools") if (site / name).exists()]
    assert {path.name for path in (unpacked / "opt/lookback/bin").iterdir()} >= {"lookback", "python"}
    assert not list((unpacked / "opt/lookback/bin").glob("pip*"))
    bill = json.loads((unpacked / "usr/share/doc/lookback/sbom.cdx.json").read_text())
    assert bill["metadata"]["component"]["purl"] == f"pkg:pypi/lookback-nav@{edge.__version__}"
    listed = {one["name"] for one in (bill["metadata"]["component"], *bill["components"])}
    installed = list(distributions(path=[str(site)]))
    assert {re.sub("[-_.]+", "-", one.name).lower() for one in installed} == listed
    owned = {str(file) for one in installed for file in one.files or ()}
    there = {str(file.relative_to(site)) for file in site.rglob("*") if file.is_file() and file.suffix != ".pyc"}
    assert there <= owned, "a file that is of no package in the list"
    assert (unpacked / "usr/share/doc/lookback/copyright").read_text().startswith("Format: https://www.debian.org/")
    assert f"python3 (>= 3.{minor}), python3 (<< 3.{minor + 1})" in control
    assert not (unpacked / "DEBIAN/conffiles").exists()  # or an upgrade would ask about an edited config
    assert not (unpacked / "etc").exists()
    example = unpacked / "usr/share/doc/lookback/examples/lookback.toml"
    assert example.read_bytes() == (checkout / "edge/default.toml").read_bytes()
    assert (unpacked / "usr/bin/lookback").readlink() == Path("/opt/lookback/bin/lookback")
    for file in (
        "opt/lookback/bin/lookback",
        "usr/lib/systemd/system/lookback.service",
        "usr/lib/systemd/system/lookback-camera.socket",
        "usr/lib/systemd/system/lookback.service.d/backoff.conf",
        "usr/lib/sysusers.d/lookback.conf",
        "usr/lib/tmpfiles.d/lookback.conf",
        "usr/lib/udev/rules.d/70-lookback.rules",
    ):
        assert (unpacked / file).is_file(), file
    assert (unpacked / "opt/lookback/bin/lookback").read_text().startswith("#!/opt/lookback/bin/python\n")


def test_a_package_names_who_answers_for_it(tmp_path: Path) -> None:
    for who in ([], ["--maintainer", "nobody"]):
        result = run(BUILD_DEB, *who)
        assert (result.returncode, result.stderr) == (
            1,
            "build-deb.sh: who answers for this package? --maintainer 'Name <address>'\n",
        )
    assert run(BUILD_DEB, "--help").stdout.startswith("Usage: build-deb.sh --maintainer")


def test_the_list_of_components_has_every_package_with_its_license() -> None:
    site = str(Path(msgspec.__file__).parents[1])
    packages = sorted({one.name for one in distributions(path=[site])}, key=str.lower)
    command = [sys.executable, str(SYSTEMD / "components.py"), site]
    bill = json.loads(subprocess.run([*command, "sbom"], capture_output=True, check=True).stdout)
    found = {one["name"]: one for one in bill["components"]}
    assert {re.sub(r"[-_.]+", "-", name).lower() for name in packages} - {"lookback-nav"} == set(found)
    assert found["msgspec"]["licenses"] == [{"expression": "BSD-3-Clause"}]
    assert found["numpy"]["purl"] == f"pkg:pypi/numpy@{version('numpy')}"
    files = {part["name"] for one in bill["components"] for part in one.get("components", ()) if part["type"] == "file"}
    libraries = {str(file.relative_to(site)) for file in Path(site).glob("*.libs/*.so*")}
    assert libraries and libraries <= files  # OpenSSL of the wheel of OpenCV, for example
    copyright_file = subprocess.run([*command, "copyright"], capture_output=True, text=True, check=True).stdout
    assert "License: various" not in copyright_file
    paragraphs = [part for part in copyright_file.split("\n\n") if part.strip()]
    assert len(paragraphs) >= len(packages) - 1
    for part in paragraphs:
        assert re.fullmatch(r"Files: .+\nCopyright: .+\nLicense: .+\n .+", part.strip()), part


def test_what_a_vehicle_installs_is_locked_with_hashes() -> None:
    """And fits what pyproject.toml asks for."""
    asked = tomllib.loads((SYSTEMD.parent / "pyproject.toml").read_text())["project"]
    extras = asked["optional-dependencies"]
    core = (SYSTEMD / "lock/core.txt").read_text()
    for name, needs in {
        "core": asked["dependencies"],
        **{one: extras[one] for one in ("page", "oak", "stream")},
    }.items():
        text = core + (SYSTEMD / f"lock/{name}.txt").read_text()
        for block in re.split(r"\n(?=[a-z])", text.strip()):
            assert re.match(r"[a-z0-9-]+==\S+( ; .*)? \\\n    --hash=sha256:[0-9a-f]{64}", block), block
        locked = [Requirement(line.removesuffix(" \\")) for line in re.findall(r"(?m)^[a-z].*", text)]
        for need in map(Requirement, needs):
            pins = [str(pin.specifier).removeprefix("==") for pin in locked if pin.name == need.name.lower()]
            assert pins, need
            assert all(need.specifier.contains(pin) for pin in pins) or need.marker, (need, pins)


def test_the_list_of_an_image_has_the_packages_of_its_system() -> None:
    if shutil.which("dpkg-query") is None:
        pytest.skip("needs dpkg-query")
    command = [sys.executable, "-c", "import components, json; print(json.dumps(components.system_components()))"]
    shown = subprocess.run(command, cwd=SYSTEMD, capture_output=True, check=True).stdout
    purls = {one["name"]: one["purl"] for one in json.loads(shown)}
    assert purls.get("python") == (
        f"pkg:generic/python@{platform.python_version()}" if sys.base_prefix != "/usr" else None
    )
    if sys.base_prefix != "/usr":
        assert purls["pip"].startswith("pkg:pypi/pip@")  # of ensurepip, which venv installs
    assert re.fullmatch(r"pkg:deb/debian/libc6@[^ ]+\?arch=[a-z0-9]+", purls["libc6"])
    assert all(re.fullmatch(r"pkg:[^ ]+@[^ ]+", purl) for purl in purls.values())


SCRIPTS = [
    INSTALL,
    BUILD_DEB,
    SYSTEMD / "trim.sh",
    *(SYSTEMD / "deb" / name for name in ("preinst", "postinst", "prerm", "postrm")),
]


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_shellcheck(script: Path) -> None:
    tool = shutil.which("shellcheck", path=f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    if tool is None:
        pytest.skip("needs shellcheck")
    result = subprocess.run([tool, script], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout
