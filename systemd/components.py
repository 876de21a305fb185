"""What an environment of Python consists of: a CycloneDX SBOM, and the paragraphs of a Debian copyright file.

Usage: components.py SITE_PACKAGES sbom|copyright. From the metadata of each installed package, with nothing but the
standard library, so that it runs wherever a package is built.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator, Sequence
from importlib.metadata import Distribution, distributions
from typing import Any

LICENSES = {
    "Apache Software License": "Apache-2.0",
    "BSD License": "BSD-3-Clause",
    "GNU Lesser General Public License v3 (LGPLv3)": "LGPL-3.0-only",
    "GNU Lesser General Public License v3 or later (LGPLv3+)": "LGPL-3.0-or-later",
    "ISC License (ISCL)": "ISC",
    "MIT License": "MIT",
    "Mozilla Public License 2.0 (MPL 2.0)": "MPL-2.0",
    "Python Software Foundation License": "PSF-2.0",
}
"""SPDX names of PyPI's classifiers, for packages that name no expression."""


def license_of(one: Distribution) -> str:
    """An SPDX expression where the package says one, or else what it says in its own words."""
    about = one.metadata
    said = about.get("License-Expression", "")
    kinds = [line.rpartition(" :: ")[2] for line in about.get_all("Classifier") or () if line.startswith("License ::")]
    known = [LICENSES[kind] for kind in kinds if kind in LICENSES]
    words = (about.get("License") or "").strip().splitlines()
    return said or " AND ".join(known) or (words[0] if words else "") or "see its .dist-info folder"


def licensed_files(one: Distribution) -> list[str]:
    """Names of the files of its license, in its .dist-info folder."""
    found = (file for file in one.files or () if ".dist-info" in str(file))
    return sorted(str(file) for file in found if re.search("licen[cs]e|copying|notice", str(file), re.IGNORECASE))


def sbom(packages: Sequence[Distribution]) -> str:
    """CycloneDX 1.6, without a time, so that the same packages give the same bytes."""
    (lookback,) = (one for one in packages if one.name == "lookback-nav")
    components = [_component(one, "library") for one in packages if one is not lookback]
    about = {"component": _component(lookback, "application")}
    return json.dumps(
        {"bomFormat": "CycloneDX", "specVersion": "1.6", "version": 1, "metadata": about, "components": components},
        indent=1,
    )


def _component(one: Distribution, kind: str) -> dict[str, Any]:
    name = re.sub(r"[-_.]+", "-", one.name).lower()
    purl = f"pkg:pypi/{name}@{one.version}"
    said = license_of(one)
    is_spdx = re.fullmatch(r"[\w.+-]+( (AND|OR|WITH) [\w.+-]+)*", said)
    names = [{"expression": said}] if is_spdx else [{"license": {"name": said}}]
    return {"type": kind, "bom-ref": purl, "name": name, "version": one.version, "purl": purl, "licenses": names}


def copyright_of(packages: Sequence[Distribution]) -> Iterator[str]:
    """A paragraph for each package but Lookback, which systemd/deb/copyright has."""
    for one in packages:
        if one.name == "lookback-nav":
            continue
        parts = {str(file).partition("/")[0] + "/*" * ("/" in str(file)) for file in one.files or ()}
        tops = sorted(parts - {"../*", "__pycache__/*"})
        author = one.metadata.get("Author") or one.metadata.get("Author-email") or f"the authors of {one.name}"
        said = license_of(one)
        short = re.sub(r"[^\w.+() -]", "-", said).replace(" AND ", " and ").replace(" OR ", " or ")
        texts = " ".join(licensed_files(one)) or "METADATA"
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
    if arguments[1] == "sbom":
        print(sbom(packages))
    else:
        print("\n".join(copyright_of(packages)))


if __name__ == "__main__":
    main(sys.argv[1:])
