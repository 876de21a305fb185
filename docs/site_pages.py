"""What `make docs` changes of the pages: README is the first one, and links out of the docs lead nowhere."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import griffe
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[1]


def on_files(files: Files, config: Any) -> Files:
    """README as the first page."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    files.append(File.generated(config, "index.md", content=text.replace("](docs/", "](")))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Links to README lead to the first page; those to other files of the repository become their names."""
    markdown = markdown.replace("](../README.md", "](index.md")
    return re.sub(r"(?<!!)\[([^\]]+)\]\((?:\.\./|LICENSE|CONTRIBUTING|edge/|firmware_config)[^)]*\)", r"\1", markdown)


class Examples(griffe.Extension):
    """Shows the examples at the end of docstrings as code."""

    def on_instance(self, *, obj: griffe.Object, **_: Any) -> None:
        """As Extension has it."""
        if obj.docstring and ">>>" in obj.docstring.value:
            text, example = obj.docstring.value.split(">>>", 1)
            obj.docstring.value = f"{text}```python\n>>>{example}\n```"
