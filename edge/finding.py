"""One thing that `lookback doctor` found, and what to do about it."""

from __future__ import annotations

from typing import Literal

import msgspec


class Finding(msgspec.Struct, frozen=True):
    """level: "bad" keeps `lookback run` from working, "note" does not. remedy: what to do, "" if nothing."""

    level: Literal["good", "note", "bad"]
    what: str
    words: str
    remedy: str = ""


def good(what: str, words: str) -> Finding:
    """All is well."""
    return Finding("good", what, words)


def note(what: str, words: str, remedy: str = "") -> Finding:
    """Worth knowing."""
    return Finding("note", what, words, remedy)


def bad(what: str, words: str, remedy: str) -> Finding:
    """It will not work like this."""
    return Finding("bad", what, words, remedy)
