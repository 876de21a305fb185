"""A file is replaced whole, or not at all."""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path

import pytest

from edge.files import BackgroundWorker, replacing


def test_the_new_content_is_in_place_only_after_the_block(tmp_path: Path) -> None:
    file = tmp_path / "state"
    file.write_bytes(b"old")
    with replacing(file) as stream:
        stream.write(b"new")
        stream.flush()
        assert file.read_bytes() == b"old"
    assert file.read_bytes() == b"new"
    assert list(tmp_path.iterdir()) == [file]


def test_an_exception_in_the_block_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    file = tmp_path / "state"
    file.write_bytes(b"old")
    with pytest.raises(KeyboardInterrupt), replacing(file) as stream:
        stream.write(b"half of the n")
        raise KeyboardInterrupt
    assert file.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [file]


def test_a_disk_that_hangs_holds_up_nobody(tmp_path: Path) -> None:
    """A pipe that nobody reads stands for the disk: it cannot even be opened."""
    os.mkfifo(tmp_path / "pipe")
    behind, file = BackgroundWorker(), tmp_path / "file"
    behind.start(partial((tmp_path / "pipe").write_bytes, b"new"))
    assert not behind.wait(0.1), "it has begun"
    behind.start(partial(file.write_bytes, b"older"))
    behind.start(partial(file.write_bytes, b"newest"))
    assert not behind.wait(0.01) and not file.exists()
    assert (tmp_path / "pipe").read_bytes() == b"new"
    assert behind.wait() and file.read_bytes() == b"newest"
    behind.start(file.unlink)
    assert behind.wait() and not file.exists()
