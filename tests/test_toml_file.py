"""Errors of TOML files name the file and the key, whatever the file is for."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from edge.errors import FeedError
from edge.toml_file import read_toml


class Item(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    size: int = 0


class Named(msgspec.Struct, frozen=True):
    name: str
    view: str
    width: int


class Document(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    count: int = 0
    section: Item = Item()
    items: tuple[Item, ...] = ()
    named: tuple[Named, ...] = ()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("count = 'x'", "count: expected a whole number, got text in quotes"),
        ("cuont = 1", "unknown key `cuont`"),
        ("[sektion]\nsize = 1", "unknown section `sektion`"),
        ("[section]\nsize = 'x'", "[section] size: expected a whole number, got text in quotes"),
        ("[section]\nsise = 1", "[section] unknown key `sise`"),
        ("section = 1", "[section] expected a section, got a whole number"),
        ("[[items]]\nsize = 'x'", "items[0].size: expected a whole number, got text in quotes"),
        ("[[named]]\nname = 'a'\nview = 'b'", "named[0]: the key `width` is missing"),
        ("[[named]]\nname = 'a'", "named[0]: the keys `view`, `width` are missing"),
        ("count = ", "not TOML: "),
    ],
)
def test_the_key_is_named(text: str, says: str, tmp_path: Path) -> None:
    file = tmp_path / "document.toml"
    file.write_text(text)
    with pytest.raises(FeedError) as caught:
        read_toml(file, Document, FeedError)
    assert str(caught.value).startswith(f"{file}: {says}")
    assert "\n" not in str(caught.value)
