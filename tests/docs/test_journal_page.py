"""docs/journal.md says what the records say."""

from __future__ import annotations

from tests.docs.journal_page import PAGE, journal_page


def test_the_page_is_what_the_records_say() -> None:
    assert PAGE.read_text(encoding="utf-8") == journal_page(), "write it anew: python -m tests.docs.journal_page"
