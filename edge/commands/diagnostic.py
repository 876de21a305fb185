"""One thing that `lookback doctor` found, and what to do about it."""

from __future__ import annotations

from typing import Literal

import msgspec


class Diagnostic(msgspec.Struct, frozen=True):
    """level: "bad" keeps `lookback run` from working, "note" does not. remedy: what to do, "" if nothing."""

    level: Literal["good", "note", "bad"]
    what: str
    words: str
    remedy: str = ""


def good(what: str, words: str) -> Diagnostic:
    """All is well."""
    return Diagnostic("good", what, words)


def note(what: str, words: str, remedy: str = "") -> Diagnostic:
    """Worth knowing."""
    return Diagnostic("note", what, words, remedy)


def bad(what: str, words: str, remedy: str) -> Diagnostic:
    """It will not work like this."""
    return Diagnostic("bad", what, words, remedy)
