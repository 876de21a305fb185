"""What an environment of Python consists of: a CycloneDX SBOM, and the paragraphs of a Debian copyright file.

Usage: components.py SITE_PACKAGES sbom|sbom-of-image|copyright. From the metadata of each installed package, with
nothing but the standard library, so that it runs wherever a package is built. An image has as well the Python that runs
this, and Debian's packages.
"""

from __future__ import annotations

import ensurepip
import hashlib
import json
import platform
import re
import subprocess
import sys
import sysconfig
from collections.abc import Iterator, Sequence
from importlib.metadata import Distribution, distributions
from pathlib import Path
from typing import Any

LICENSES = {
    "3-Clause BSD License": "BSD-3-Clause",
    "Apache Software License": "Apache-2.0",
    "BSD License": "BSD-3-Clause",
    "GNU Lesser General Public License v3 (LGPLv3)": "LGPL-3.0-only",
    "GNU Lesser General Public License v3 or later (LGPLv3+)": "LGPL-3.0-or-later",
    "ISC License (ISCL)": "ISC",
    "MIT License": "MIT",
    "Mozilla Public License 2.0 (MPL 2.0)": "MPL-2.0",
    "Python Software Foundation License": "PSF-2.0",
}
"""SPDX names of PyPI's classifiers and of packages' own words, for packages that name no expression."""
COMMON = {"Apache-2.0": "Apache-2.0", "BSD-3-Clause": "BSD"}
"""The files of /usr/share/common-licenses, for packages that come without the text."""


def license_of(one: Distribution) -> str:
    """An SPDX expression where the package says one, or else what it says in its own words."""
    said = _field(one, "License-Expression")
    classes = one.metadata.get_all("Classifier") or ()
    kinds = [line.rpartition(" :: ")[2] for line in classes if line.startswith("License ::")]
    known = [LICENSES[kind] for kind in kinds if kind in LICENSES]
    words = _field(one, "License").strip().splitlines()
    return said or " AND ".join(known) or (LICENSES.get(words[0], words[0]) if words else "see its .dist-info folder")


def _name(said: str) -> str:
    """As PyPI compares names."""
    return re.sub(r"[-_.]+", "-", said).lower()


def _field(one: Distribution, name: str) -> str:
    """Of its metadata; "" where it is not there."""
    return str((one.metadata.get_all(name) or [""])[0])


def licensed_files(one: Distribution) -> list[str]:
    """Names of the files of its license, in its .dist-info folder and at the top of its package."""
    found = [str(file) for file in one.files or () if not str(file).endswith((".py", ".pyc"))]
    near = [file for file in found if ".dist-info" in file or file.count("/") == 1]
    return sorted(file for file in near if re.search("licen[cs]e|copying|notice", file, re.IGNORECASE))


def sbom(packages: Sequence[Distribution], others: Sequence[dict[str, Any]] = ()) -> str:
    """CycloneDX 1.6, without a time, so that the same packages give the same bytes."""
    (lookback,) = (one for one in packages if one.name == "lookback-nav")
    components = [_component(one, "library") for one in packages if one is not lookback] + list(others)
    about = {"component": _component(lookback, "application")}
    return json.dumps(
        {"bomFormat": "CycloneDX", "specVersion": "1.6", "version": 1, "metadata": about, "components": components},
        indent=1,
    )


def _component(one: Distribution, kind: str) -> dict[str, Any]:
    name = _name(one.name)
    purl = f"pkg:pypi/{name}@{one.version}"
    said = license_of(one)
    is_spdx = re.fullmatch(r"[\w.+-]+( (AND|OR|WITH) [\w.+-]+)*", said)
    names = [{"expression": said}] if is_spdx else [{"license": {"name": said}}]
    inside = _inside(one)
    found = {"type": kind, "bom-ref": purl, "name": name, "version": one.version, "purl": purl, "licenses": names}
    return {**found, "components": inside} if inside else found


def _inside(one: Distribution) -> list[dict[str, Any]]:
    """What a wheel brings along: the components of its own lists (PEP 770), and shared libraries as files."""
    found: dict[str, dict[str, Any]] = {}
    for file in one.files or ():
        path = Path(str(one.locate_file(file)))
        if "/sboms/" in str(file) and path.suffix == ".json":
            for part in json.loads(path.read_text(encoding="utf-8")).get("components", ()):
                if "purl" in part and not part["purl"].startswith("pkg:pypi/"):
                    found[part["purl"]] = {key: part[key] for key in ("type", "name", "version", "purl") if key in part}
        elif ".libs/" in str(file) and path.is_file():
            digest = hashlib.sha256(path.read_bytes()).hexdigest()
            found[str(file)] = {"type": "file", "name": str(file), "hashes": [{"alg": "SHA-256", "content": digest}]}
    return [found[key] for key in sorted(found)]


def system_components() -> list[dict[str, Any]]:
    """Debian's packages; Python where it is none of them, what is installed in it, and the wheels that venv copies."""
    query = ["dpkg-query", "--show", "--showformat", "${Package} ${Version} ${Architecture}\\n"]
    shown = subprocess.run(query, capture_output=True, text=True, check=True).stdout
    about = [line.split() for line in sorted(shown.splitlines())]
    rows = [(name, number, f"pkg:deb/debian/{name}@{number}?arch={arch}") for name, number, arch in about]
    if sys.base_prefix != "/usr":
        version = platform.python_version()
        rows.append(("python", version, f"pkg:generic/python@{version}"))
    wheels = Path(ensurepip.__file__).parent.rglob("*.whl")
    of_python = {(_name(one.name), one.version) for one in distributions(path=[sysconfig.get_path("purelib")])}
    for name, version in sorted(
        of_python | {(_name(one[0]), one[1]) for one in (file.name.split("-") for file in wheels)}
    ):
        rows.append((name, version, f"pkg:pypi/{name}@{version}"))
    return [{"type": "library", "bom-ref": purl, "name": one, "version": of, "purl": purl} for one, of, purl in rows]


def copyright_of(packages: Sequence[Distribution]) -> Iterator[str]:
    """A paragraph for each package but Lookback, which systemd/deb/copyright has."""
    for one in packages:
        if one.name == "lookback-nav":
            continue
        parts = {str(file).partition("/")[0] + "/*" * ("/" in str(file)) for file in one.files or ()}
        tops = sorted(parts - {"../*", "__pycache__/*"})
        author = _field(one, "Author") or _field(one, "Author-email") or f"the authors of {one.name}"
        said = license_of(one)
        short = re.sub(r"[^\w.+() -]", "-", said).replace(" AND ", " and ").replace(" OR ", " or ")
        common = [f"/usr/share/common-licenses/{COMMON[name]}" for name in (said,) if name in COMMON]
        texts = " ".join(licensed_files(one) or common) or "its METADATA"
        yield "\n".join(
            [
                "",
                f"Files: {' '.join(f'opt/lookback/lib/python3*/site-packages/{top}' for top in tops)}",
                f"Copyright: {' '.join(author.split())}",
                f"License: {short}",
                f" {one.name} {one.version}; the text is in {texts}",
            ]
        )


def main(arguments: Sequence[str]) -> None:
    """Print one of the two."""
    packages = sorted(distributions(path=[arguments[0]]), key=lambda one: one.name.lower())
    if arguments[1] != "copyright":
        print(sbom(packages, system_components() if arguments[1] == "sbom-of-image" else ()))
    else:
        print("\n".join(copyright_of(packages)))


if __name__ == "__main__":
    main(sys.argv[1:])
