"""What pyproject.toml cannot say: README as the page on PyPI, whose links and pictures lead to the repository.

The address of the repository is that of the workflow that builds the release, or REPOSITORY_URL. Without one, links
become their words, and pictures are left out.
"""

import os
import re
from pathlib import Path

HERE = Path(__file__).resolve().parent
VERSION = re.search(r'__version__ = "(.+)"', (HERE / "edge/__init__.py").read_text(encoding="utf-8"))[1]
PICTURE = re.compile(r"!\[([^\]]*)\]\((?!https?:)([^)]+)\)")
LINK = re.compile(r"(?<!!)\[((?:!\[[^\]]*\]\([^)]*\)|[^\[\]])*)\]\((?!https?:|#)([^)]+)\)")
IN_REPOSITORY = "../../"
"""What README's links to pages of the repository that are no files begin with; on GitHub they lead there."""
SITE = "deployments/github-pages"


def repository() -> str:
    """The address, "" where nobody knows it."""
    env = os.environ
    by_workflow = "{GITHUB_SERVER_URL}/{GITHUB_REPOSITORY}".format_map(env) if "GITHUB_REPOSITORY" in env else ""
    return env.get("REPOSITORY_URL", by_workflow).rstrip("/")


def site(address: str) -> str:
    """The address of the documentation, which the release publishes on GitHub Pages; elsewhere the folder docs."""
    pages = re.fullmatch(r"https://github\.com/([^/]+)/([^/]+)", address)
    return f"https://{pages[1].lower()}.github.io/{pages[2]}/" if pages else f"{address}/tree/v{VERSION}/docs"


def as_page(text: str, address: str) -> str:
    """README with its links and pictures as those of this version in the repository."""

    def absolute(path: str, kind: str) -> str:
        if path.startswith(IN_REPOSITORY):
            path = path[len(IN_REPOSITORY) :]
            return site(address) if path == SITE else f"{address}/{path}"
        return f"{address}/{kind}/v{VERSION}/{path}"

    if not address:
        return LINK.sub(r"\1", PICTURE.sub("", text))
    text = PICTURE.sub(lambda found: f"![{found[1]}]({absolute(found[2], 'raw')})", text)
    return LINK.sub(lambda found: f"[{found[1]}]({absolute(found[2], 'blob')})", text)


def urls(address: str) -> dict[str, str]:
    """What stands beside the page."""
    if not address:
        return {}
    kept = {"Changelog": "blob/v{}/CHANGELOG.md", "Issues": "issues"}
    found = {name: f"{address}/{path.format(VERSION)}" for name, path in kept.items()}
    return {"Source": address, "Documentation": site(address), **found}


if __name__ == "__main__":
    from setuptools import setup

    setup(
        long_description=as_page((HERE / "README.md").read_text(encoding="utf-8"), repository()),
        long_description_content_type="text/markdown",
        project_urls=urls(repository()),
    )
