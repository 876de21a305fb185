from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

pytest.importorskip("shtab")

from edge.__main__ import main


def test_bash_completes_commands_options_and_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", "bash"]) == 0
    script = capsys.readouterr().out
    ask = (
        "\nCOMP_WORDS=(lookback {words}); COMP_CWORD={at}; "
        "_shtab_lookback lookback '{last}' ''; printf '%s\\n' \"${{COMPREPLY[@]}}\""
    )

    def complete(*words: str) -> set[str]:
        asked = ask.format(words=" ".join(f"'{word}'" for word in words), at=len(words), last=words[-1])
        done = subprocess.run(["bash", "-c", script + asked], capture_output=True, text=True, check=True)
        return set(done.stdout.split())

    assert "replay" in complete("re")
    assert "record" in complete("re")
    assert complete("map", "bu") == {"build"}
    assert "--confidence-from" in complete("replay", "--conf")
    (tmp_path / "rover.toml").touch()
    assert complete("run", f"{tmp_path}/rov") == {f"{tmp_path}/rover.toml"}


def test_a_script_for_each_shell(capsys: pytest.CaptureFixture[str]) -> None:
    for shell in ("zsh", "tcsh"):
        assert main(["completion", shell]) == 0
        assert "calibrate" in capsys.readouterr().out
