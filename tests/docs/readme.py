"""The figures of README: `python -m tests.docs.readme` writes them anew.

They are of the tables under docs/, which other commands write, and of what the demo and README's own commands print:
these run in a folder of their own, which takes some minutes.
"""

from __future__ import annotations

import re
from pathlib import Path
from statistics import median_low
from tempfile import TemporaryDirectory

from tests.common import ROOT

README = ROOT / "README.md"
NUMBERS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten")
FLOWN = re.compile(r"^\| (\d+) \| (right|3 % wrong) \| (.* m) \| (.* m) \|$", re.MULTILINE)
PRINTED = (
    ("95 % within {} m of its lane; {} m without Lookback", "95 % of the time within {} m of its lane ({} m without"),
    ("Recognized: {} % of the frames, {} % after the start",) * 2,
    ("precision {} of {} accepted places",) * 2,
    ("the matched place lies {} m ahead ± {} m",) * 2,
)
"""What commands print, and how README says it."""


def page(name: str) -> str:
    return (ROOT / "docs" / name).read_text(encoding="utf-8")


def pattern(template: str) -> re.Pattern[str]:
    return re.compile(re.escape(template).replace(r"\{\}", r"([\w.,/%]+(?: (?:[\d.]+|/|m))*)"))


def filled(text: str, template: str, values: tuple[str, ...]) -> str:
    """The text with these values where it says what the template says, which it does once."""
    new, count = pattern(template).subn(template.format(*values).replace("\\", r"\\"), text)
    assert count == 1, f"README says {count} times: {template}"
    return new


def by_tables(text: str) -> str:
    """README with the figures of the tables."""
    flights = page("flights.md")
    (now,) = re.findall(r"^- now: (\d+) positions; of (\d+) whose .* has, 0 beyond three", flights, re.MULTILINE)
    by_night = dict(re.findall(r"^\| \d+ (\w+), night \| \d+ \| ([\d.]+) /", flights, re.MULTILINE))
    sent, known = (f"{int(number):,}" for number in now)
    said = "{} positions, median error at night {} m (ArduPilot), {} m (PX4)"
    text = filled(text, said, (sent, by_night["ArduPilot"], by_night["PX4"]))
    text = filled(text, "none of the {} with a recorded sigma exceeds 3 sigma", (known,))

    by_road = {found[:2]: found[2:] for found in FLOWN.findall(flights)}
    roads = re.findall(r"^\| (\d+) \| .* m \|$", text, re.MULTILINE)
    for road in roads:
        cells = *by_road[road, "right"], *by_road[road, "3 % wrong"]
        text = filled(text, f"\n| {road} | {{}} | {{}} | {{}} | {{}} |", cells)
    p95 = [[cell.split(" / ")[1] for cell in by_road[road, "3 % wrong"]] for road in roads]
    ends = [end(column, key=float) for column in zip(*p95, strict=True) for end in (min, max)]
    said = "{} to {} m (95th percentile, {} roads), {} to {} m without"
    text = filled(text, said, (*ends[:2], NUMBERS[len(roads)], *ends[2:]))

    frames = page("keypoints.md").partition("<!-- keyframes: begin -->")[2]
    first = re.findall(r"^\| \w+ \| \w+ \| (\d+), \d+ m \| (\d+), \d+ m \|", frames, re.MULTILINE)
    without, with_keypoints = (sorted(map(int, column)) for column in zip(*first, strict=True))
    said = "usually accepted after {} m with [keypoints](docs/keypoints.md), after {} to {} m without"
    return filled(text, said, (f"{median_low(with_keypoints)}", f"{without[0]}", f"{without[-1]}"))


def printed(text: str) -> list[float]:
    """The figures of what was printed, or of README."""
    found = [pattern(printed).search(text) or pattern(said).search(text) for printed, said in PRINTED]
    return [float(figure) for one in found if one for figure in one.groups()]


def by_output(text: str, output: str) -> str:
    """README with the figures of what its commands printed."""
    for template, said in PRINTED:
        (values,) = pattern(template).findall(output)
        text = filled(text, said, values)
    return text


if __name__ == "__main__":
    from tests.docs.test_docs import run_all_of_readme

    with TemporaryDirectory() as folder:
        output = run_all_of_readme(Path(folder))
    README.write_text(by_output(by_tables(README.read_text(encoding="utf-8")), output), encoding="utf-8")
