"""What `make docs` changes of the pages, so that they need no script and nothing from elsewhere.

README is the first page. Links out of the docs lead to the repository; where nobody knows its address (`setup.py`),
they become their words. A Mermaid figure becomes the picture that `python -m tests.docs.figures` drew of it, LaTeX
becomes MathML. GitHub shows both by itself.
"""

from __future__ import annotations

import html
import posixpath
import re
import runpy
from pathlib import Path
from typing import Any

import griffe
from latex2mathml.converter import convert
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[1]
SETUP = runpy.run_path(str(ROOT / "setup.py"), run_name="read")
BADGE = re.compile(r"^\[!\[.*\)\n", re.MULTILINE)
OUTSIDE = re.compile(
    r"(?<!!)\[([^\]]+)\]\(((?:\.\./|LICENSE|CONTRIBUTING|CODE_OF|edge/|firmware_config|lookback_fc6|notebook)[^)]*)\)"
)
FIGURE = re.compile(r"^```mermaid\n%% (pictures/\w+\.svg): (.*)\n(?:.*\n)*?```$", re.MULTILINE)
"""Its picture, and what that shows."""
FRONT = {
    "pictures/page_home_night.png": "the live page, on the way home",
    "pictures/report.webp": "<code>lookback try</code>: what is recognized, and why not",
    "pictures/coverage.webp": "<code>lookback map coverage</code>: where the next drive will be",
}
"""Pictures of the first page beside that of the drive, which README has, and their words."""
EQUATION = re.compile(r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>', re.DOTALL)


def on_config(config: Any) -> Any:
    """With a link to the repository in the foot of each page, where its address is known."""
    if address := SETUP["repository"]():
        config.copyright = f'<a href="{address}">Source</a>, {config.copyright}'
    return config


def on_files(files: Files, config: Any) -> Files:
    """README as the first page, without badges, which are loaded from elsewhere."""
    text = BADGE.sub("", (ROOT / "README.md").read_text(encoding="utf-8"))
    shown = "".join(
        f'<figure><img src="{name}" alt=""><figcaption>{words}</figcaption></figure>\n' for name, words in FRONT.items()
    )
    pictures = f'<div class="pictures">\n{shown}</div>\n\n- **Beside its lane**'
    text = text.replace("- **Beside its lane**", pictures).replace("](docs/", "](")
    files.append(File.generated(config, "index.md", content=f"---\ntitle: Home\n---\n{text}"))
    return files


def on_page_markdown(markdown: str, *, page: Any, **_: Any) -> str:
    """Links to README lead to the first page, those to other files of the repository to this version of them."""
    address = SETUP["repository"]()

    def outside(found: re.Match[str]) -> str:
        words, path = found.groups()
        inside = posixpath.normpath(posixpath.join(posixpath.dirname(page.file.src_uri), path))
        if path.startswith("../") and not inside.startswith("../"):
            return found[0]  # from a folder of the docs to a page of them
        if not address or path.startswith(SETUP["IN_REPOSITORY"]):
            return words
        folder = "" if page.file.src_uri == "index.md" else posixpath.dirname(f"docs/{page.file.src_uri}")
        return f"[{words}]({address}/blob/v{SETUP['VERSION']}/{posixpath.normpath(posixpath.join(folder, path))})"

    markdown = FIGURE.sub(r"![\2](\1)", markdown)
    return OUTSIDE.sub(outside, markdown.replace("](../README.md", "](index.md"))


def on_page_content(content: str, **_: Any) -> str:
    """Equations as MathML, which browsers show."""

    def shown(found: re.Match[str]) -> str:
        text = convert(html.unescape(found[3]).strip(), display="block" if found[2] == "[" else "inline")
        return f'<div style="overflow-x: auto">{text}</div>' if found[2] == "[" else text

    return EQUATION.sub(shown, content)


class Examples(griffe.Extension):
    """Shows the examples at the end of docstrings as code."""

    def on_instance(self, *, obj: griffe.Object, **_: Any) -> None:
        """As Extension has it."""
        if obj.docstring and ">>>" in obj.docstring.value:
            text, example = obj.docstring.value.split(">>>", 1)
            obj.docstring.value = f"{text}```python\n>>>{example}\n```"
