"""docs/glossary.md against code and docs: its terms are used, and the words that they replaced stay away."""

from __future__ import annotations

import ast
import dataclasses
import re
from collections import Counter
from pathlib import Path
from typing import get_args

import pytest
from msgspec import Struct

from edge.config import RigConfig
from edge.journal.records import KINDS, RENAMED
from edge.localization.gps_monitor import GpsVerdictState
from edge.telemetry import LinkStatus
from edge.telemetry.shadow import ShadowPosition
from sim.journal import GPS_STATES

ROOT = Path(__file__).parents[2]
PACKAGES = ("edge", "edge_plugins", "sim", "lookback")
GLOSSARY = ROOT / "docs/glossary.md"
OTHER_PAGES = [ROOT / "README.md", *(page for page in sorted((ROOT / "docs").glob("*.md")) if page != GLOSSARY)]
ROW = re.compile(r"^\| ([a-z][\w -]+) \| `(\w+)` \| ([\w, ]*?) ?\| .* \| `([\w/]+\.py)` \|$", re.MULTILINE)
ROWS = ROW.findall(GLOSSARY.read_text(encoding="utf-8"))
STILL_A_WORD = {"Pose"}
"""`sim.Pose` is one of the simulator."""
NO_NAMES = {"Agreed", "Asked", "Best", "Judged", "Kept", "Known", "Near", "Used"}
"""Words that say what happened to a thing, and not which it is."""


def defined_in(source: str) -> set[str]:
    """Classes and aliases of types at the top of a file."""
    body = ast.parse(source).body
    classes = {node.name for node in body if isinstance(node, ast.ClassDef)}
    return classes | {
        node.target.id for node in body if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name)
    }


def classes() -> Counter[str]:
    """How often each name is one of a class; private ones are their file's own."""
    files = (file for package in PACKAGES for file in (ROOT / package).rglob("*.py"))
    return Counter(
        name for file in files for name in re.findall(r"^\s*class ([A-Z]\w*)", file.read_text("utf-8"), re.MULTILINE)
    )


def is_used(term: str, text: str) -> bool:
    """Whether a text has a term, whatever its line breaks and capitals."""
    return re.search(r"\b" + r"[\s-]+".join(re.split(r"[\s-]", term)), text, re.IGNORECASE) is not None


def test_states_and_keys_are_called_as_the_glossary_says() -> None:
    words = dict(re.findall(r"`([\w ]+)` \(([\w ]+)\)", GLOSSARY.read_text("utf-8").partition("## States")[2]))
    kinds: tuple[type[Struct], ...] = (*KINDS, ShadowPosition, RigConfig)
    keys = {field for kind in kinds for field in kind.__struct_fields__}
    keys |= {field.name for field in dataclasses.fields(LinkStatus)}
    states = set(get_args(GpsVerdictState))
    assert words == {**{new: old for old, new in GPS_STATES.items()}, **{new: old for old, new in RENAMED.items()}}
    assert words.keys() <= keys | states and not set(words.values()) & (keys | states)
    page = (ROOT / "edge_plugins/page/page.html").read_text("utf-8")
    shown = re.search(r"const GPS_KINDS = {(.*)};", page)
    assert shown and set(re.findall(r'([a-z][a-z ]*)"?: "', shown[1])) == states - {"cannot say"}


REPLACED = re.compile(r"(called|calls GPS) wrong|GPS (agrees|disagrees|is doubtful)\b")


def test_no_page_code_or_message_says_of_gps_what_the_glossary_replaced() -> None:
    files = [file for package in (*PACKAGES, "firmware_config") for file in (ROOT / package).rglob("*")]
    texts = [file for file in files if file.suffix in {".py", ".toml", ".html", ".lua", ".md", ".param"}]
    assert [str(file) for file in (*texts, *OTHER_PAGES) if REPLACED.search(file.read_text("utf-8"))] == []


def test_the_glossary_is_read_whole() -> None:
    lines = [line for line in GLOSSARY.read_text(encoding="utf-8").splitlines() if line.startswith("| ")]
    assert len(ROWS) == len(lines) - 1 > 20, "one is the header"


@pytest.mark.parametrize(("term", "name", "_", "file"), ROWS, ids=[row[0] for row in ROWS])
def test_each_term_of_the_glossary_is_found_in_code_and_docs(term: str, name: str, _: str, file: str) -> None:
    source = (ROOT / ("" if file.startswith("sim/") else "edge") / file).read_text(encoding="utf-8")
    assert name in defined_in(source), f"{file} has no {name}"
    assert is_used(term, source), f"{file} does not say {term!r}"
    assert any(is_used(term, page.read_text(encoding="utf-8")) for page in OTHER_PAGES), f"no page says {term!r}"


def test_no_class_has_a_name_that_the_glossary_replaced_or_that_another_one_has() -> None:
    replaced = {word for row in ROWS for word in row[2].split(", ") if word} - STILL_A_WORD
    found = classes()
    assert sorted((replaced | NO_NAMES) & found.keys()) == []
    assert [name for name, count in found.items() if count > 1] == []
