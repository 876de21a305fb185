"""What pyproject.toml cannot say: README as the page on PyPI, whose links and pictures lead to the repository.

The address of the repository is that of the workflow that builds the release, or REPOSITORY_URL. Without one, links
become their words, and pictures are left out.
"""

import os
import re
from pathlib import Path

HERE = Path(__file__).resolve().parent
VERSION = re.search(r'__version__ = "(.+)"', (HERE / "edge/__init__.py").read_text(encoding="utf-8"))[1]
RELATIVE = re.compile(r"(!?)\[([^\]]*)\]\((?!https?:|#)([^)#]+)(#[^)]*)?\)")


def repository() -> str:
    """The address, "" where nobody knows it."""
    env = os.environ
    by_workflow = "{GITHUB_SERVER_URL}/{GITHUB_REPOSITORY}".format_map(env) if "GITHUB_REPOSITORY" in env else ""
    return env.get("REPOSITORY_URL", by_workflow).rstrip("/")


def as_page(text: str, address: str) -> str:
    """README with its links and pictures as those of this version in the repository."""

    def absolute(found: re.Match[str]) -> str:
        picture, words, path, anchor = found.groups(default="")
        if not address:
            return "" if picture else words
        kind = "raw" if picture else "blob"
        return f"{picture}[{words}]({address}/{kind}/v{VERSION}/{path}{anchor})"

    return RELATIVE.sub(absolute, text)


def urls(address: str) -> dict[str, str]:
    """What stands beside the page."""
    if not address:
        return {}
    kept = {"Documentation": "tree/v{}/docs", "Changelog": "blob/v{}/CHANGELOG.md", "Issues": "issues"}
    return {"Source": address, **{name: f"{address}/{path.format(VERSION)}" for name, path in kept.items()}}


if __name__ == "__main__":
    from setuptools import setup

    setup(
        long_description=as_page((HERE / "README.md").read_text(encoding="utf-8"), repository()),
        long_description_content_type="text/markdown",
        project_urls=urls(repository()),
    )
