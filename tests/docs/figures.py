"""The figures of the docs: `python -m tests.docs.figures` makes the architecture anew, and draws what has changed.

A figure is Mermaid, on a page or in a file, whose first line names its picture. Drawing needs Chromium and npm, which
brings Mermaid.
"""

from __future__ import annotations

import hashlib
import re
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory

import edge
from tests.chromium import browser

DOCS = Path(__file__).parents[2] / "docs"
ARCHITECTURE = DOCS / "pictures/architecture.mmd"
FIGURE = re.compile(r"^```mermaid\n(%% (pictures/\w+\.svg): .*\n(?:.*\n)*?)```$", re.MULTILINE)
STAGE = re.compile(r"^    (\w+)/ +(-> )?(.*)$", re.MULTILINE)
MERMAID = "mermaid@11.17.2"
DRAW = """const [text, done] = arguments;
mermaid.initialize({startOnLoad: false, theme: "neutral", htmlLabels: false, deterministicIds: true,
    flowchart: {htmlLabels: false, useMaxWidth: false, wrappingWidth: 520, rankSpacing: 24}});
mermaid.render("figure", text).then(drawn => done(drawn.svg), wrong => done(String(wrong)));"""


def architecture() -> str:
    """The stages that `edge/__init__.py` lists, in its order; each has what it passes on."""
    stages = STAGE.findall((edge.__doc__ or "").partition("The files beside them")[0])
    lines = ["%% pictures/architecture.svg: The stages that a frame goes through", "flowchart TB"]
    before, handed_on = "", ""
    for name, hands_on, words in stages:
        text = re.sub(r"  +", ": ", words).replace('"', "#quot;").replace("`", "")
        link = before and f"{before} {'-->' if hands_on or handed_on else '~~~'} "
        lines.append(f'  {link}{name}["{name}/<br>{text}"]')
        before, handed_on = name, hands_on
    return "\n".join([*lines, ""])


def figures() -> dict[str, tuple[str, str]]:
    """Each picture's Mermaid, and the comment that its file must begin with."""
    pages = "".join(page.read_text(encoding="utf-8") for page in sorted(DOCS.glob("*.md")))
    found = [*FIGURE.findall(pages), (ARCHITECTURE.read_text(encoding="utf-8"), "pictures/architecture.svg")]
    head = "<!-- Drawn by {} of {} -->\n"
    return {picture: (text, head.format(MERMAID, hashlib.sha256(text.encode()).hexdigest())) for text, picture in found}


def stale() -> list[str]:
    """Pictures that are of another text than the pages have."""
    drawn = "".join(picture.read_text(encoding="utf-8") for picture in (DOCS / "pictures").glob("*.svg"))
    return [name for name, (_, head) in figures().items() if head not in drawn]


def draw(names: list[str]) -> None:
    with TemporaryDirectory() as folder, browser(1200, 900) as chromium:
        bring = f"npm pack --silent {MERMAID} && tar xzf *.tgz package/dist/mermaid.min.js"
        subprocess.run(bring, cwd=folder, check=True, shell=True)
        (page := Path(folder) / "page.html").write_text("<script src='package/dist/mermaid.min.js'></script>")
        chromium.get(page.as_uri())
        for name in names:
            text, head = figures()[name]
            drawn = chromium.execute_async_script(DRAW, text)
            assert drawn.startswith("<svg"), f"{name}: {drawn}"
            (DOCS / name).write_text(f"{head}{drawn}\n", encoding="utf-8")


if __name__ == "__main__":
    ARCHITECTURE.write_text(architecture(), encoding="utf-8")
    draw(stale())
