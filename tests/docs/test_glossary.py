"""docs/glossary.md against code and docs: its terms are used, and the words that they replaced stay away."""

from __future__ import annotations

import ast
import dataclasses
import re
import tokenize
from collections import Counter
from collections.abc import Iterator
from functools import cache
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
ROW = re.compile(r"^\| ([a-z][\w -]+) \| `(\w+)` \| .* \| `([\w/]+\.py)` \|$", re.MULTILINE)
ROWS = ROW.findall(GLOSSARY.read_text(encoding="utf-8"))
EARLIER = """Agreed Anchor Asked Bank Best Bound Break ByOwn Claim Claims Displacement Errors GpsJudge GyroOdometer
Judged Kept Known Look Looks Moved Near Own OwnMotion OwnPosition Passed Points Reckoned Reckoning Refusal Seen Sight
Sighted Sighting Used Verified WayHome Wrong"""
NO_NAMES = set(re.findall(r"\w+", EARLIER))
"""Of classes: names of earlier versions, and words that say what happened to a thing, and not which it is."""


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
    table, _, lists = GLOSSARY.read_text("utf-8").partition("## States")
    assert len(ROWS) == table.count("\n| ") - 1 and len(ROWS) > 20, "every row is read; one is the header"
    words = dict(re.findall(r"`([\w ]+)` \(([\w ]+)\)", lists))
    kinds: tuple[type[Struct], ...] = (*KINDS, ShadowPosition, RigConfig)
    keys = {field for kind in kinds for field in kind.__struct_fields__}
    keys |= {field.name for field in dataclasses.fields(LinkStatus)}
    states = set(get_args(GpsVerdictState))
    assert words == {**{new: old for old, new in GPS_STATES.items()}, **{new: old for old, new in RENAMED.items()}}
    assert words.keys() <= keys | states and not set(words.values()) & (keys | states)
    page = (ROOT / "edge_plugins/page/page.html").read_text("utf-8")
    shown = re.search(r"const GPS_KINDS = {(.*)};", page)
    assert shown and set(re.findall(r'([a-z][a-z ]*)"?: "', shown[1])) == states - {"cannot say"}


@pytest.mark.parametrize(("term", "name", "file"), ROWS, ids=[row[0] for row in ROWS])
def test_each_term_of_the_glossary_is_found_in_code_and_docs(term: str, name: str, file: str) -> None:
    source = (ROOT / ("" if file.startswith(("sim/", "edge_plugins/")) else "edge") / file).read_text(encoding="utf-8")
    assert name in defined_in(source), f"{file} has no {name}"
    assert is_used(term, source), f"{file} does not say {term!r}"
    assert any(is_used(term, page.read_text(encoding="utf-8")) for page in OTHER_PAGES), f"no page says {term!r}"


def test_no_class_has_a_name_that_the_glossary_replaced_or_that_another_one_has() -> None:
    found = classes()
    assert sorted(NO_NAMES & found.keys()) == []
    assert [name for name, count in found.items() if count > 1] == []


NAMES = re.compile(
    r"_*(look(s|ed)?|sight(ed|ings?)|aside)(_\w+)?|\w+_(look(s|ed)?|sight(ed|ings?)|aside)", re.IGNORECASE
)
"""Local names, functions and keys in words of earlier versions."""
ORDINARY = re.compile(r"look_(ahead_\w+|sigma_m|key|alike)|_?look_up|_gps_steered_aside")
"""Keys that configs have, and ordinary English."""
WORDS = re.compile(
    r"\b(a|an|one|two|by|of|each|every|newest|last|first|further|single|all|no) looks?\b(?![ -](like|alike|at|up))"
    r"|\blooked at\b|\bsightings?\b|(?<!gps[ -])\bdragged\b|\bthe newest matches disagree\b"
    r"|(called|calls GPS) wrong|GPS (agrees|disagrees|is doubtful)\b",
    re.IGNORECASE,
)
"""A keypoint pose or a verification, a match, a spoofing drift and states of GPS, as earlier versions called them."""
TEXTS = tokenize.STRING, tokenize.COMMENT, getattr(tokenize, "FSTRING_MIDDLE", tokenize.STRING)
"""Docstrings, messages and comments; from Python 3.12 on an f-string has tokens of its own."""


def tokens(*kinds: int) -> Iterator[tuple[str, str]]:
    """Of all code and tests but these, with the file's name; a string over several lines is one."""
    for file in (file for folder in (*PACKAGES, "tests") for file in (ROOT / folder).rglob("*.py")):
        if file.name == Path(__file__).name:
            continue
        with file.open(encoding="utf-8") as source:
            found = tokenize.generate_tokens(source.readline)
            yield from ((file.name, one.string) for one in found if one.type in kinds)


def test_no_name_in_the_code_is_a_word_that_the_glossary_replaced() -> None:
    found = {(file, one) for file, one in tokens(tokenize.NAME) if NAMES.fullmatch(one)}
    assert sorted(one for one in found if not ORDINARY.fullmatch(one[1])) == []


def test_no_docstring_comment_message_or_page_has_a_word_that_the_glossary_replaced() -> None:
    files = [file for package in (*PACKAGES, "firmware_config", "docs/tables") for file in (ROOT / package).rglob("*")]
    files = [file for file in files if file.suffix in {".toml", ".html", ".lua", ".md", ".param"}]
    texts = [(file.name, file.read_text("utf-8")) for file in (*files, *OTHER_PAGES)]
    texts += [(file, one) for file, one in tokens(*TEXTS) if " " in one]
    assert [(file, found[0]) for file, text in texts if (found := WORDS.search(re.sub(r"\s+", " ", text)))] == []


NO_MESSAGE = {"relative pose", "pose measurement", "datum", "gyro-derived heading", "autopilot state", "filter bank"}
NO_MESSAGE |= {"position aiding", "discontinuity", "kidnapped"}
"""Terms of code and docs alone: no message, help or comment of the config speaks of such a thing."""


@cache
def messages() -> list[str]:
    """Strings that are no docstrings, the config's comments, and the page."""
    said = [file.read_text("utf-8") for file in (ROOT / "edge/default.toml", ROOT / "edge_plugins/page/page.html")]
    for file in (file for package in PACKAGES for file in (ROOT / package).rglob("*.py")):
        nodes = [*ast.walk(ast.parse(file.read_text("utf-8")))]
        docstrings = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
        strings = (node for node in nodes if isinstance(node, ast.Constant) and id(node) not in docstrings)
        said += [node.value for node in strings if isinstance(node.value, str) and " " in node.value]
    return said


def test_each_other_term_is_found_in_a_message() -> None:
    said = "\0".join(messages())
    assert {row[0] for row in ROWS if not is_used(row[0], said)} == NO_MESSAGE


def test_a_place_is_accepted_in_each_text_that_a_person_reads() -> None:
    """The journal's word; "believed" stood beside it."""
    pages = [*OTHER_PAGES, *(ROOT / "docs/tables").glob("*.md")]
    texts = [*messages(), *(page.read_text("utf-8") for page in pages)]
    assert [one[:80] for one in texts if re.search(r"(?<!{)\b[Bb]elieve[ds]\b", one)] == []
