"""Bit flips and truncations of a map: all are refused in one line, without much memory."""

from __future__ import annotations

import os
import random
import tracemalloc
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from edge.errors import MapError
from edge.reference_map.store import open_map


def refused(path: Path) -> bool:
    try:
        open_map(path, every_file=True)
    except MapError as error:
        message = str(error)
        return "\n" not in message and str(path) in message
    return False


def flip(file: Path, bit: int) -> None:
    with file.open("r+b") as stream:
        stream.seek(bit // 8)
        (value,) = stream.read(1)
        stream.seek(bit // 8)
        stream.write(bytes([value ^ 1 << bit % 8]))


def bits(path: Path, share: int, rng: random.Random) -> Iterator[tuple[Path, int]]:
    """One in `share` of all bits of all files of a map, at random places."""
    for file in sorted(path.iterdir()):
        size = file.stat().st_size * 8
        yield from ((file, bit) for bit in sorted(rng.sample(range(size), size // share)))


@pytest.mark.parametrize("share", [25, pytest.param(1, marks=pytest.mark.soak)], ids=["1 in 25", "every bit"])
def test_bit_flips_of_a_small_map(
    share: int, make_map: Callable[..., Path], tmp_path: Path, seed: int, figures: Callable[[str], None]
) -> None:
    path = make_map(tmp_path / "small.map", places=4, dimensions=8)
    flips = 0
    for file, bit in bits(path, share, random.Random(seed)):
        flip(file, bit)
        assert refused(path), f"bit {bit} of {file.name}"
        flip(file, bit)
        flips += 1
    open_map(path, every_file=True)
    figures(f"{flips} flips refused")


def test_every_truncation_of_a_small_map(
    make_map: Callable[..., Path], tmp_path: Path, figures: Callable[[str], None]
) -> None:
    path = make_map(tmp_path / "small.map", places=4, dimensions=8)
    cuts = 0
    for file in sorted(path.iterdir()):
        whole = file.read_bytes()
        for length in reversed(range(len(whole))):
            os.truncate(file, length)
            assert refused(path), f"{file.name} cut to {length}"
            cuts += 1
        file.write_bytes(whole + b"\0")
        assert refused(path), f"{file.name} with a byte more"
        file.unlink()
        assert refused(path), f"without {file.name}"
        file.write_bytes(whole)
    open_map(path, every_file=True)
    figures(f"{cuts} truncations refused")


@pytest.mark.parametrize("flips", [100, pytest.param(10_000, marks=pytest.mark.soak)])
@pytest.mark.parametrize(("places", "dimensions"), [(50, 128), (2, 4096), (200, 512), (400, 1024)])
def test_flips_of_a_larger_map_cost_little_memory(
    places: int,
    dimensions: int,
    flips: int,
    make_map: Callable[..., Path],
    tmp_path: Path,
    seed: int,
    figures: Callable[[str], None],
) -> None:
    """From 25 kB on, a fifth of the smallest map by the shipped network; reading needs 13 kB itself."""
    path = make_map(tmp_path / "large.map", places=places, dimensions=dimensions)
    largest = max(file.stat().st_size for file in path.iterdir())
    rng = random.Random(seed)
    files = sorted(path.iterdir())
    # What is made once in a process, at the first refusal of each kind, is no cost of a file.
    drawn = [(file, rng.randrange(file.stat().st_size * 8)) for file in rng.choices(files, k=2 * flips)]
    for number, (file, bit) in enumerate(drawn):
        if number == flips:
            tracemalloc.start()
        flip(file, bit)
        assert refused(path), f"bit {bit} of {file.name}"
        flip(file, bit)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    figures(f"{flips} flips refused; peak {peak / 1e3:.0f} kB, largest file {largest / 1e3:.0f} kB")
    assert peak < 2 * largest
