"""Every sentence that docs/troubleshooting.md quotes is one that the program says."""

from __future__ import annotations

import ast
import re
from functools import cache

from tests.common import ROOT

PAGE = (ROOT / "docs/troubleshooting.md").read_text(encoding="utf-8")
VARIES = re.compile(r"%[-0-9.]*[sdfg]|\{\}|\.\.\.")


@cache
def spoken() -> str:
    """All texts in the code, with "..." where they differ from one time to the next."""
    texts = []
    for folder in ("edge", "edge_plugins", "sim"):
        for file in (ROOT / folder).rglob("*.py"):
            for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
                parts = node.values if isinstance(node, ast.JoinedStr) else [node]
                words = [part.value if isinstance(part, ast.Constant) else "..." for part in parts]
                texts.append("".join(word for word in words if isinstance(word, str)))
    return "\0".join(VARIES.sub("...", text) for text in texts)


def unspoken(page: str) -> list[str]:
    """The quoted sentences that no text in the code has."""
    rows = re.findall(r"^- ((?:`[^`]+`[^`:]*)+):\s", page, re.MULTILINE)
    quoted = [one for row in rows for one in re.findall(r"`([^`]+)`", row)]
    return [one for one in quoted if one.removesuffix("...").rstrip() not in spoken()]


def test_every_quoted_sentence_is_said_by_the_program() -> None:
    assert len(re.findall(r"^- `", PAGE, re.MULTILINE)) > 20
    assert unspoken(PAGE) == []
