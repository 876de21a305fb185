"""Compare the list of components of a container's image with what lies in the image; exit code 1 where they differ.

Usage: scan_image.py ROOT, the image's files in a folder (docker export). It reads what Debian's dpkg, Python's packages
and their wheels say of themselves, in any folder, and asks of each program, library and module which of them it belongs
to.
"""

from __future__ import annotations

import hashlib
import json
import re
import sys
from collections.abc import Iterator
from importlib.metadata import PathDistribution
from pathlib import Path
from typing import Any

SBOM = "opt/lookback/sbom.cdx.json"


def main(root: Path) -> int:
    """Print what is listed and not there, there and not listed, and of no component; 0 where there is no such line."""
    bill = json.loads((root / SBOM).read_text(encoding="utf-8"))
    parts = [bill["metadata"]["component"], *bill["components"]]
    listed = {part["purl"] for part in parts}
    inside = [one for part in parts for one in part.get("components", ())]
    hashes = {one["hashes"][0]["content"] for one in inside if one["type"] == "file"}
    found = dict(debian_packages(root))
    found |= python_packages(root, {file for files in found.values() for file in files}) | dict(pythons(root))
    owned, there = {file for files in found.values() for file in files}, set(found)
    lines = [f"not in the list: {purl}" for purl in sorted(there - listed)]
    lines += [f"in the list, and not in the image: {purl}" for purl in sorted(listed - there)]
    code = [path for path in sorted(root.rglob("*")) if is_code(path)]
    for path in code:
        name = inner(root, path)
        if name not in owned:
            lines.append(f"of no component: /{name}")
        elif ".libs/" in name and hashlib.sha256(path.read_bytes()).hexdigest() not in hashes:
            lines.append(f"a library that a wheel brings along, and not in the list: /{name}")
    print(
        "\n".join(lines) or f"{len(listed)} components, all in the list; {len(code)} files of code, each of a component"
    )
    return int(bool(lines))


def inner(root: Path, path: Path) -> str:
    """The name inside the image, by its real folder: /lib is /usr/lib."""
    return str((path.parent.resolve() / path.name).relative_to(root.resolve()))


def debian_packages(root: Path) -> Iterator[tuple[str, list[str]]]:
    """Each installed one with its files."""
    for block in (root / "var/lib/dpkg/status").read_text(encoding="utf-8").split("\n\n"):
        about: dict[str, Any] = dict(re.findall(r"(?m)^([\w-]+): (.*)$", block))
        if about.get("Status") != "install ok installed":
            continue
        name, version, machine = about["Package"], about["Version"], about["Architecture"]
        lists = [root / f"var/lib/dpkg/info/{one}.list" for one in (name, f"{name}:{machine}")]
        files = next(one for one in lists if one.exists()).read_text(encoding="utf-8").splitlines()
        yield f"pkg:deb/debian/{name}@{version}?arch={machine}", [inner(root, root / file[1:]) for file in files]


def python_packages(root: Path, debian: set[str]) -> dict[str, list[str]]:
    """Each with its files, and each wheel that waits to be installed (ensurepip's), but for what is Debian's."""
    found: dict[str, list[str]] = {}
    for about in (*root.rglob("*.dist-info/METADATA"), *root.rglob("*.whl")):
        if (own := inner(root, about)) in debian:
            continue
        if about.suffix == ".whl":
            (name, version), files = about.name.split("-")[:2], [own]
        else:
            one = PathDistribution(about.parent)
            name, version = one.name, one.version
            files = [inner(root, about.parents[1] / str(file)) for file in one.files or ()]
        found.setdefault(f"pkg:pypi/{re.sub(r'[-_.]+', '-', name).lower()}@{version}", []).extend(files)
    return found


def pythons(root: Path) -> Iterator[tuple[str, list[str]]]:
    """Those that were compiled for the image, with their own modules."""
    for program in root.glob("usr/local/bin/python3.*[0-9]"):
        header = (root / f"usr/local/include/{program.name}/patchlevel.h").read_text(encoding="utf-8")
        (version,) = re.findall(r'PY_VERSION\s+"([^"+]+)', header)
        own = (*root.glob("usr/local/lib/libpython3*"), *root.glob("usr/local/lib/python3*/**/*"))
        files = [inner(root, path) for path in own if "site-packages" not in path.parts]
        yield f"pkg:generic/python@{version}", [inner(root, program), *files]


def is_code(path: Path) -> bool:
    """A program or library of machine code, or a module of Python."""
    if path.is_symlink() or not path.is_file():
        return False
    if path.suffix == ".py":
        return True
    with path.open("rb") as file:
        return file.read(4) == b"\x7fELF"


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
