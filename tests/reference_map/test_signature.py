"""Signed maps: a vehicle that asks for a signature takes what its owner has signed, and nothing else."""

from __future__ import annotations

import re
import shutil
import stat
from collections.abc import Callable
from pathlib import Path

import pytest

from edge.__main__ import main
from edge.config import SamplingConfig
from edge.reference_map.map_folder import SIGNATURE


@pytest.fixture(scope="module")
def street_map(make_street: Callable[..., Path]) -> Path:
    return make_street(range(12), sampling=SamplingConfig(by="frames")) / "map"


@pytest.fixture
def signed(street_map: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Path:
    """A signed copy of the map, with a key, and a configuration that asks for its signature."""
    shutil.copytree(street_map, tmp_path / "map")
    assert main(["map", "keygen", str(tmp_path / "owner")]) == 0
    assert main(["map", "sign", str(tmp_path / "map"), "--key", str(tmp_path / "owner")]) == 0
    (tmp_path / "lookback.toml").write_text(
        '[map]\npath = "map"\nrequire_signature_by = "owner.pub"\n[sequence]\nlength = 4\n[telemetry]\njournal = ""\n'
    )
    capsys.readouterr()
    return tmp_path


def refusal(config: Path, capsys: pytest.CaptureFixture[str], *command: str) -> str:
    assert main([*(command or ("doctor", "--offline")), str(config)]) == 78
    out, err = capsys.readouterr()
    (line,) = [line for line in out.splitlines() if line.startswith("BAD ")] or err.splitlines()
    return line


def test_a_signed_map_is_taken(signed: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", "--offline", str(signed / "lookback.toml")]) == 0
    assert stat.S_IMODE((signed / "owner").stat().st_mode) == 0o600
    assert main(["map", "verify", str(signed / "map")]) == 0


def test_an_unsigned_map_is_refused(signed: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (signed / "map" / SIGNATURE).unlink()
    for command in (("doctor", "--offline"), ("run",)):
        assert "map: not signed, and [map] require_signature_by asks for it" in refusal(
            signed / "lookback.toml", capsys, *command
        )
    assert main(["doctor", str(signed / "lookback.toml"), "--seconds", "0"]) == 1
    assert re.search("^BAD +map .*map: not signed", capsys.readouterr().out, re.MULTILINE)


def test_a_map_that_was_changed_after_signing_is_refused(
    signed: Path, write_traverse: Callable[..., Path], capsys: pytest.CaptureFixture[str]
) -> None:
    signature = (signed / "map" / SIGNATURE).read_bytes()
    feed = write_traverse(signed / "more", range(20, 26))
    assert main(["map", "extend", str(signed / "map"), str(feed)]) == 0
    capsys.readouterr()
    assert not (signed / "map" / SIGNATURE).exists()
    (signed / "map" / SIGNATURE).write_bytes(signature)
    assert "its signature is not that of" in refusal(signed / "lookback.toml", capsys)


@pytest.mark.parametrize("damage", [b"", b"zz", b"00" * 64, b"\xff" * 128, b"00" * 100_000])
def test_a_signature_that_is_none_is_refused(signed: Path, damage: bytes, capsys: pytest.CaptureFixture[str]) -> None:
    (signed / "map" / SIGNATURE).write_bytes(damage)
    assert "its signature is not that of" in refusal(signed / "lookback.toml", capsys)


def test_every_bit_of_the_signature_counts(signed: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from edge.errors import MapError
    from edge.reference_map.map_folder import check_signature
    from edge.reference_map.store import open_map

    path, file = signed / "map", signed / "map" / SIGNATURE
    header = open_map(path).header
    good = bytes.fromhex(file.read_text())
    for bit in range(8 * len(good)):
        flipped = bytearray(good)
        flipped[bit // 8] ^= 1 << bit % 8
        file.write_text(flipped.hex())
        with pytest.raises(MapError, match="its signature is not that of"):
            check_signature(path, header, signed / "owner.pub")
    file.write_text(good.hex())
    check_signature(path, header, signed / "owner.pub")


def test_another_ones_key(signed: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["map", "keygen", str(signed / "other")]) == 0
    assert main(["map", "sign", str(signed / "map"), "--key", str(signed / "other")]) == 0
    capsys.readouterr()
    assert "its signature is not that of" in refusal(signed / "lookback.toml", capsys)


def test_keys_that_are_none(signed: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (signed / "owner.pub").write_text("not a key\n")
    assert "owner.pub: not a key of 32 bytes, or of 64 hexadecimal digits; make one" in refusal(
        signed / "lookback.toml", capsys
    )
    (signed / "owner.pub").unlink()
    assert "owner.pub: cannot read this key: No such file" in refusal(signed / "lookback.toml", capsys)
    (signed / "owner").chmod(0o644)
    told = refusal(signed / "map", capsys, "map", "sign", "--key", str(signed / "owner"))
    assert "other users can read this key; chmod 600" in told
    assert "a key already exists here" in refusal(signed / "owner", capsys, "map", "keygen")
