"""Recordings whose answers were right once, and must stay as they are; `lookback dev golden` makes them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from edge.__main__ import main
from sim.evaluation.golden import EXPECTED, first_difference, load_golden, replay_golden

FOLDERS = sorted(path.parent for path in (Path(__file__).parents[3] / "tests/golden").glob("*/golden.toml"))


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_the_answers_are_what_they_were(folder: Path) -> None:
    golden = load_golden(folder)
    missing = [path for path in (*golden.reference, golden.query) if not (folder / path).exists()]
    if missing:
        pytest.skip(f"needs the recording {missing[0]}, which is not there")
    assert first_difference((folder / EXPECTED).read_text(encoding="utf-8"), replay_golden(folder, golden)) == ""


def test_a_recording_becomes_a_test_with_one_command(
    write_traverse: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, again = write_traverse(tmp_path / "out", range(40)), write_traverse(tmp_path / "again", range(40), noise=8.0)
    folder = str(tmp_path / "golden/street")
    assert (
        main(["dev", "golden", folder, "--reference", str(out), "--query", str(again), "--sequence-length", "10"]) == 0
    )
    assert main(["dev", "golden", folder]) == 0
    assert "unchanged" in capsys.readouterr().out
    expected = tmp_path / "golden/street" / EXPECTED
    lines = expected.read_text().splitlines()
    assert len(lines) == 40
    expected.write_text("\n".join([*lines[:20], lines[20].replace('"place":', '"place":1'), *lines[21:]]) + "\n")
    assert main(["dev", "golden", folder]) == 1
    assert "line 21:\n  expected " in capsys.readouterr().out
    assert main(["dev", "golden", folder, "--rebuild"]) == 0
    assert expected.read_text().splitlines() == lines


def test_what_was_recorded_in_the_field_becomes_a_test(write_traverse: Callable[..., Path], tmp_path: Path) -> None:
    """Two drives through `lookback record`, which has no positions here, and one of them as an MCAP file."""
    for name, noise in (("out", 0.0), ("again", 8.0)):
        street = write_traverse(tmp_path / f"street_{name}", range(40), noise=noise, period_ms=80)
        config = tmp_path / f"{name}.toml"
        config.write_text(
            f'[camera]\nkind = "feed"\ndevice = "{street}"\n[sampling]\nby = "frames"\n'
            '[telemetry]\nconnection = "udp:127.0.0.1:9"\n'
        )
        assert main(["record", str(config), "-o", str(tmp_path / name)]) == 0
    assert main(["dev", "mcap", "write", str(tmp_path / "again"), "-o", str(tmp_path / "again.mcap")]) == 0
    folder, options = tmp_path / "golden/field", ["--spacing-frames", "1", "--sequence-length", "5"]
    made = ["dev", "golden", str(folder), "--reference", str(tmp_path / "out"), "--query", str(tmp_path / "again.mcap")]
    assert main([*made, *options]) == 0
    assert main(["dev", "golden", str(folder)]) == 0
    assert '"direction":"forward"' in (folder / EXPECTED).read_text()


def test_mistakes_are_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["dev", "golden", str(tmp_path)]) == 78
    assert "make one with --reference and --query" in capsys.readouterr().err
    assert main(["dev", "golden", str(tmp_path), "--query", "x"]) == 78
    (tmp_path / "golden.toml").write_text("query = 3\n")
    assert main(["dev", "golden", str(tmp_path)]) == 78
    assert main(["dev", "golden", str(tmp_path), "--query", "x", "--reference", "y"]) == 78
    assert "exists already" in capsys.readouterr().err
