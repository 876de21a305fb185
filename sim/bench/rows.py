"""One line of the bench: what was measured, side by side with what."""

from __future__ import annotations

from dataclasses import dataclass

from sim.bench.timing import Times


@dataclass(frozen=True)
class Row:
    """what: the stage and its size. times: of it. against: the rival's or the floor's name. ratio: of it to that.

    ratio is over 1 where it took longer than what it is held against.
    """

    what: str
    times: Times | None = None
    against: str = ""
    ratio: float | None = None
    note: str = ""


@dataclass(frozen=True)
class Target:
    """One line of the table of targets. value: what was measured; met: None where it was not measured."""

    what: str
    wanted: str
    value: str
    met: bool | None


@dataclass(frozen=True)
class Section:
    """A table of the page, and the targets that its rows decide."""

    title: str
    rows: list[Row]
    targets: list[Target]


def against(what: str, name: str, times: dict[str, Times], rival: str) -> Row:
    """The row of one racer against another."""
    return Row(what, times[name], rival, times[name].ratio(times[rival]))
