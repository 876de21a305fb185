"""The list in docs/positions.md, made from the rules: `python -m tests.docs.refusals_list` writes it anew."""

from __future__ import annotations

from pathlib import Path

from edge.localization.fix_rules import RULES
from sim.research.trial.table import put_between

PAGE = Path(__file__).parents[2] / "docs/positions.md"


def as_list() -> str:
    """The rules for people, as a list in Markdown."""
    return "\n".join(f"- **{one.reason}**: {one.when}" for one in RULES)


if __name__ == "__main__":
    put_between("refusals", PAGE, as_list())
