"""One command writes the tables that are measured on simulated roads."""

from __future__ import annotations

from pathlib import Path

from sim.research.evaluation.__main__ import main


def test_a_table_goes_between_its_marks(tmp_path: Path) -> None:
    made, page = tmp_path / "made.md", tmp_path / "page.md"
    made.write_text("| a |\n|---|\n", encoding="utf-8")
    page.write_text("Before.\n<!-- benchmark: begin -->\nold\n<!-- benchmark: end -->\nAfter.\n", encoding="utf-8")
    main(["benchmark", "--made", str(made), "--page", str(page)])
    table = "<!-- benchmark: begin -->\n\n| a |\n|---|\n\n<!-- benchmark: end -->"
    assert page.read_text(encoding="utf-8") == f"Before.\n{table}\nAfter.\n"
