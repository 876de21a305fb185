"""Every command in README and the docs is run here, in a folder for each page, from top to bottom.

The folder is empty, or a copy of the one in which README's commands ran where the page says so. A ```toml block that
begins with `# NAME.toml` is that file, any other must be a valid config. Each ```sh block is run by bash, each
```python block by Python, and must succeed; one that begins with `# NAME.py` is that file, and only compiled, since
what it talks to may be a robot. A ```text block is a picture, a ```yaml block a file of another program. The README's
sh blocks that need make, pip or root are not run here.
"""

from __future__ import annotations

import contextlib
import csv
import fnmatch
import itertools
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, get_args

import msgspec
import pytest
from pymavlink.dialects.v20.ardupilotmega import MAVLink_heartbeat_message

import edge
from edge.commands.parser import build_parser
from edge.config import SHIPPED, Config, parse_config
from edge.descriptor.model_file import FC6_PACKAGE
from edge.feed.format import MEASURES, SOURCE, FeedHeader
from edge.geodesy import POSITION_SOURCES
from edge.journal.records import KINDS, Record
from edge.telemetry.shadow import ShadowPosition
from edge.toml_file import toml_values
from edge_plugins.home.home_requests import HomeAnswered
from edge_plugins.mapping.status import MappingChanged
from edge_plugins.motion.camera_motion import MotionMeasured
from edge_plugins.motion.velocity_sender import VelocityChanged
from sim.journal import JournalLine
from sim.research.trial.courses import COURSES
from sim.world.scenario import Scenario
from tests.common import ROOT
from tests.docs import readme

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

pytest.importorskip("panda3d")
pytest.importorskip("gpxpy")

README = ROOT / "README.md"
DOCS = sorted((ROOT / "docs").glob("*.md"))
PAGES = [README, *DOCS]
TABLES = sorted((ROOT / "docs/tables").glob("*.md"))
"""Data that commands wrote, beside the pages that say what follows of them."""
BESIDE_THE_CODE = [ROOT / "CONTRIBUTING.md", ROOT / "CODE_OF_CONDUCT.md", ROOT / "firmware_config/README.md"]
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
KINDS_OF_BLOCKS = ("sh", "toml", "python", "text", "yaml", "math", "mermaid")
MOST_S = 600
SHORTER = {
    "--gps-lost-after 20 ": "--gps-lost-after 2 ",
    "--light night ": "--light night --rehearsals 2 ",
}
"""A shorter run and fewer rehearsals show the same, in half of the time."""


def script_of(text: str, page: Path, folder: Path) -> str:
    """Write the files that a page's text shows, and return its commands."""
    commands = []
    for kind, block in BLOCK.findall(text):
        assert kind in KINDS_OF_BLOCKS, f"{page.name}: nothing runs a block of {kind or 'no kind'}"
        if kind in ("toml", "python") and (name := re.match(r"# (\w+\.(?:toml|py))\n", block)):
            (folder / name[1]).write_text(block, encoding="utf-8")
            if kind == "python":
                commands.append(f"python -m py_compile {name[1]}")
        elif kind == "toml":
            parse_config(block, page)
        elif kind == "python":
            commands.append(f"python - <<'PROGRAM'\n{block}PROGRAM")
        elif kind == "sh":
            commands.append(block)
    # A process in the background would keep the test waiting.
    return "\n".join([*commands, "kill $(jobs -p) 2> /dev/null || true"])


PRINTS = {"api": r"(?m)^-27\.47\d{4} 153\.0[23]\d{4} reverse 0\.\d\d$"}
"""What the commands of a page must print."""

AFTER_README = "](../README.md#your-own-recordings)"
"""The link of a page whose commands go on in the folder of README's."""

PRELUDE = """\
until_on_the_map() {
    : > run.log
    "$@" >> run.log 2>&1 &
    daemon=$!
    grep --quiet "${AWAITED:-on the map}" <(tail --follow=name --retry --lines=+1 --pid=$daemon run.log journal.jsonl) \
        || { cat run.log; false; }
    kill $daemon && wait $daemon
}
"""
"""A reader watches a daemon until its recording ends, a test until it is on the map, or until the journal has what the
page looks for in it; it must end well."""


@pytest.mark.long
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_command_works(page: Path, tmp_path: Path, make_once: Callable[..., Path]) -> None:
    def run_readme(folder: Path) -> None:
        (folder / "printed.txt").write_text(run_all_of_readme(folder), encoding="utf-8")

    if page == README:
        output = (make_once("readme", run_readme) / "printed.txt").read_text(encoding="utf-8")
    else:
        if AFTER_README in page.read_text(encoding="utf-8"):
            shutil.copytree(make_once("readme", run_readme), tmp_path, dirs_exist_ok=True)
        output = run_page(page, tmp_path)
    assert re.search(PRINTS.get(page.stem, ""), output)
    if page == README:
        said, now = (readme.printed(text) for text in (page.read_text(encoding="utf-8"), output))
        # Another processor rounds otherwise.
        assert said == pytest.approx(now, rel=0.1), "write README's figures anew: python -m tests.docs.readme"


SHOWN_COMMAND = re.compile(r" *(sudo |(- )?[\w.]+: )?lookback [a-z]")
"""At the beginning of a line, or the value of a key in YAML."""


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_command_that_is_shown_exists_with_its_options(page: Path) -> None:
    """Those too that no test runs, since they need a vehicle, a container or somebody's recordings."""
    for line in page.read_text(encoding="utf-8").splitlines():
        words = shlex.split(line, comments=True) if SHOWN_COMMAND.match(line) else []
        if words and not line.rstrip().endswith("\\"):
            words = words[words.index("lookback") + 1 :]
            words = list(itertools.takewhile(lambda word: word not in ("|", ">", "&", "2>", "&&"), words))
            try:
                build_parser(words).parse_args(words)
            except SystemExit as refused:
                raise AssertionError(f"{page.name}: {line}") from refused


def run_all_of_readme(folder: Path) -> str:
    """As they are shown, since README says what they print, and the demo."""
    return run_in(folder, "lookback demo -o demo --require-good") + run_page(README, folder, {})


def run_page(page: Path, folder: Path, shorter: Mapping[str, str] = SHORTER) -> str:
    """`make`, `pip` and the steps on a vehicle are not for a test."""
    text = BLOCK.sub(lambda block: "" if is_not_for_a_test(block) else block[0], page.read_text(encoding="utf-8"))
    for shown, tried in shorter.items():
        text = text.replace(shown, tried)
    text = text.replace("\nlookback run ", "\nuntil_on_the_map lookback run ")
    if found := re.search(r"^grep (\w+) journal\.jsonl", text, re.MULTILINE):
        text = text.replace("until_on_the_map", f"AWAITED={found[1]} until_on_the_map")
    return run_in(folder, PRELUDE + script_of(text, page, folder))


def is_not_for_a_test(block: re.Match[str]) -> bool:
    return block[1] == "sh" and re.search(r"^(make|pip|sudo) ", block[2], re.MULTILINE) is not None


def run_in(folder: Path, script: str) -> str:
    """Run a script, which must succeed, and return its output."""
    environment = {**os.environ, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    with subprocess.Popen(
        ["bash", "-euxo", "pipefail", "-c", script],
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    ) as process:
        try:
            output, _ = process.communicate(timeout=MOST_S)
        finally:
            with contextlib.suppress(ProcessLookupError):  # if it ran into the timeout
                os.killpg(process.pid, signal.SIGTERM)
    assert process.returncode == 0, output[-3000:]
    assert "Traceback" not in output
    return output


@pytest.mark.parametrize(
    "page", [*PAGES, *TABLES, *BESIDE_THE_CODE], ids=lambda page: f"{page.parent.name}/{page.stem}"
)
def test_every_link_leads_somewhere(page: Path) -> None:
    for file, anchor in re.findall(r"\]\(([^)#:]*)(?:#([^)]*))?\)", page.read_text(encoding="utf-8")):
        if page == README and file.startswith("../../"):  # of the repository on GitHub: held by test_pypi_page
            continue
        target = page.parent / file if file else page
        assert target.exists(), f"{page.name}: {file}"
        assert not anchor or anchor in anchors(target), f"{page.name}: {file}#{anchor}"


DECIMAL = re.compile(r"(?<![\d.,])\d+\.\d+(?![\d.])")


@pytest.mark.parametrize("page", TABLES, ids=lambda page: page.stem)
def test_what_a_page_says_of_a_table_stands_in_the_table(page: Path) -> None:
    """Each table is linked, and the decimal figures of a paragraph that links to one are some of its own."""
    table, text = page.read_text(encoding="utf-8"), (ROOT / "docs" / page.name).read_text(encoding="utf-8")
    said = [one for one in re.split(r"\n\s*\n|\n- ", text) if f"](tables/{page.name}#" in one]
    linked = {anchor for one in said for anchor in re.findall(rf"\(tables/{page.name}#([\w-]+)\)", one)}
    tables = WRITTEN.findall(table)
    assert len(linked) == len(tables) and len(tables) > 0
    known = set(DECIMAL.findall(table))
    assert [(figure, one) for one in said for figure in DECIMAL.findall(one) if figure not in known] == []


def test_every_hazard_has_tests_that_exist_and_courses_that_are_driven() -> None:
    with (ROOT / "docs/hazards.csv").open(encoding="utf-8", newline="") as file:
        hazards = list(csv.DictReader(file))
    assert len(hazards) >= 20 and all(one["tests"] for one in hazards)
    assert {name for one in hazards for name in one["tests"].split()} <= names_of_tests()
    patterns = {pattern for one in hazards for pattern in one["courses"].split()}
    assert [one for one in patterns if not fnmatch.filter(COURSES, one)] == []


def test_every_point_on_robustness_has_tests_that_exist() -> None:
    page = (ROOT / "docs/robustness.md").read_text(encoding="utf-8")
    with (ROOT / "docs/robustness.csv").open(encoding="utf-8", newline="") as file:
        tests = {one["begins"]: one["tests"].split() for one in csv.DictReader(file)}
    for begins, names in tests.items():
        assert re.search(rf"^(- )?{re.escape(begins)}", page, re.MULTILINE), begins
        assert names and set(names) <= names_of_tests(), begins
    points = re.findall(r"^- (.*)$", page, re.MULTILINE)
    assert [one for one in points if sum(map(one.startswith, tests)) != 1] == []


def test_every_example_is_linked_and_is_a_program() -> None:
    text = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    for example in (ROOT / "docs/examples").iterdir():
        assert f"](examples/{example.name})" in text
        assert example.suffix != ".py" or compile(example.read_text(encoding="utf-8"), example.name, "exec")


def anchors(page: Path) -> list[str]:
    """What GitHub calls the headings of a page."""
    headings = re.findall(r"^#+ (.*)$", BLOCK.sub("", page.read_text(encoding="utf-8")), re.MULTILINE)
    return [re.sub(r"[^\w -]", "", heading).lower().replace(" ", "-") for heading in headings]


def test_every_state_is_explained() -> None:
    from edge.health.health import HealthState

    page = (ROOT / "docs/vehicle.md").read_text(encoding="utf-8")
    for state in get_args(HealthState):
        assert f"| {state} |" in page


MOST_WORDS = 35
"""In a sentence: longer ones are read twice."""
MOST_WORDS_IN_ALL = 22_550
"""Of all pages in `docs/`, as `wc -w docs/*.md` counts. Whoever makes a page shorter lowers it."""
WRITTEN = re.compile(r"<!-- (.*?): begin -->.*?<!-- \1: end -->", re.DOTALL)
"""What a command writes: tables, and lists of whatever was found."""


def sentences(text: str) -> Iterator[str]:
    """The sentences of a page's paragraphs, list items and cells; neither code nor what a command writes."""
    text = WRITTEN.sub("", BLOCK.sub("", text))
    text = re.sub(r"\]\([^)]*\)", "]", re.sub(r"^(#| {4}).*$", "", text, flags=re.MULTILINE))
    for part in re.split(r"\n\s*\n|\n(?=\s*(?:-|\d+\.) )|\|", text):
        yield from re.split(r"(?<=[.!?])[\"*)]*\s+(?=[A-Z*`\"\[])", part)


def long_sentences(text: str) -> list[str]:
    """Those of more than MOST_WORDS words; signs and the symbols of equations are none."""
    return [one for one in sentences(text) if len(re.findall(r"\S*[A-Za-z]{2}\S*|\d\S*", one)) > MOST_WORDS]


@pytest.mark.parametrize("page", [*PAGES, ROOT / "CHANGELOG.md"], ids=lambda page: page.stem)
def test_no_sentence_is_long(page: Path) -> None:
    assert long_sentences(page.read_text(encoding="utf-8")) == []


def test_the_docs_are_short() -> None:
    words = {page.name: len(page.read_text(encoding="utf-8").split()) for page in DOCS}
    assert sum(words.values()) <= MOST_WORDS_IN_ALL, dict(sorted(words.items(), key=lambda one: -one[1])[:5])
    assert len(README.read_text(encoding="utf-8").splitlines()) <= 150


def test_a_page_has_an_example_from_two_screens_on() -> None:
    for text in (page.read_text(encoding="utf-8") for page in DOCS):
        prose = re.sub(r"^\|.*$", "", WRITTEN.sub("", BLOCK.sub("", text)), flags=re.MULTILINE).split()
        assert len(prose) < 900 or re.search(r"^```(sh|python|toml)$", text, re.MULTILINE), text[:80]


WORD = re.compile(r"`(?:\[(\w+)\] )?([a-z]+(?:_[a-z]+)+)`")
"""A word in code type that looks like a key, perhaps after its section: `spacing_m`, `[sampling] spacing_m`."""


def config_keys() -> dict[str, set[str]]:
    """The keys of each section of the configuration."""
    return {name: set(kind.__struct_fields__) for name, kind in sections().items()}


def sections() -> dict[str, Any]:
    """The struct of each section, those of plug-ins too."""
    own = {field.name: field.type for field in msgspec.structs.fields(Config) if field.name != "plugins"}
    return {**own, **{name: point.load() for name, point in SHIPPED.items()}}


def config_values() -> set[str]:
    """The words that a key may be set to."""
    kinds = [field.type for section in sections().values() for field in msgspec.structs.fields(section)]
    return {value for kind in kinds for value in get_args(kind) if isinstance(value, str)}


def journal_words() -> set[str]:
    """Kinds of journal records, their fields, and the keys of every line."""
    kinds: list[type[Record]] = [*KINDS, MotionMeasured, VelocityChanged, MappingChanged, HomeAnswered, ShadowPosition]
    fields = [field for kind in kinds for field in msgspec.structs.fields(kind)]
    tags = {str(kind.__struct_config__.tag) for kind in kinds}
    return {field.encode_name for field in fields} | tags | set(JournalLine._fields)


def message_words() -> set[str]:
    """Fields of the heartbeat, and the names of the values to plot."""
    texts = [file.read_text(encoding="utf-8") for file in (ROOT / "edge/telemetry").glob("*.py")]
    values = {name for text in texts for name in re.findall(r'\bb?"([a-z_]{1,10})"', text)}
    return values | set(MAVLink_heartbeat_message.fieldnames)


def plug_in_words() -> set[str]:
    """The functions that entry points name, and the one that a command must have."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    named = {target.rpartition(":")[2] for points in project["entry-points"].values() for target in points.values()}
    return {*named, "add_arguments"}


def names_of_tests() -> set[str]:
    """The names of all tests."""
    texts = [file.read_text(encoding="utf-8") for file in (ROOT / "tests").rglob("test_*.py")]
    return {name for text in texts for name in re.findall(r"def (test_\w+)", text)}


def unknown_words(text: str) -> list[str]:
    """Words of a page that look like a key and name nothing."""
    keys = config_keys()
    known = set().union(
        *keys.values(), config_values(), journal_words(), message_words(), plug_in_words(), edge.__all__
    )
    known |= {
        *Scenario.__struct_fields__,
        *FeedHeader.__struct_fields__,
        *names_of_tests(),
        *MEASURES,
        SOURCE,
        *POSITION_SOURCES,
    }
    return [
        word for section, word in WORD.findall(text) if word not in (keys.get(section, set()) if section else known)
    ]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_key_that_the_docs_name_exists(page: Path) -> None:
    assert unknown_words(page.read_text(encoding="utf-8")) == []


def test_the_examples_of_good_code_are_code_of_this_repository() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    examples = re.findall(r"^```python\n# (\S+)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    assert len(examples) == 2
    for file, code in examples:
        assert code in (ROOT / file).read_text(encoding="utf-8"), file


def test_each_package_names_the_license_of_its_network() -> None:
    for folder, license_name, card in (
        (ROOT, "Apache-2.0", "edge/descriptor/models/grid/README.md"),
        (ROOT, "Apache-2.0", "edge/keypoints/models/xfeat/README.md"),
        (ROOT / FC6_PACKAGE, "LicenseRef-Places-CNN-non-commercial", "README.md"),
    ):
        project = toml_values((folder / "pyproject.toml").read_text(encoding="utf-8"), folder)["project"]
        assert project["license"] == license_name
        assert card in project["license-files"] and (folder / card).is_file()
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert f"{FC6_PACKAGE}/README.md" in readme and "non-commercial" in readme
