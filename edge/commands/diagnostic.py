"""One finding of `lookback doctor`, and what to do about it."""

from __future__ import annotations

from typing import Literal

import msgspec


class Diagnostic(msgspec.Struct, frozen=True):
    """level: "bad" keeps `lookback run` from doing all of its work, "note" does not. remedy: "" if nothing is to do."""

    level: Literal["good", "note", "bad"]
    what: str
    words: str
    remedy: str = ""


def good(what: str, words: str) -> Diagnostic:
    """It works."""
    return Diagnostic("good", what, words)


def note(what: str, words: str, remedy: str = "") -> Diagnostic:
    """It works, but differently than one may expect."""
    return Diagnostic("note", what, words, remedy)


def bad(what: str, words: str, remedy: str) -> Diagnostic:
    """It does not work like this."""
    return Diagnostic("bad", what, words, remedy)
