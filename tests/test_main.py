"""Every mistake a user can make is one line on standard error that names the thing, and the exit code says the kind."""

from __future__ import annotations

import argparse
import io
import json
import logging
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from tqdm import tqdm

import edge
from edge.__main__ import AboveBars, main
from edge.commands.parser import build_parser


@pytest.fixture(scope="module")
def traverse(write_traverse: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_traverse(tmp_path_factory.mktemp("feeds") / "out", range(30))


@pytest.fixture(scope="module")
def street_map(traverse: Path) -> Path:
    path = traverse.with_name("street.map")
    assert main(["map", "build", str(traverse), "-o", str(path)]) == 0
    return path


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Run a command that must fail as a set-up error; its one line."""
    capsys.readouterr()
    assert main(list(arguments)) == 78
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert err.startswith("lookback: ")
    return err


def test_map_info_and_verify(street_map: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["map", "info", str(street_map)]) == 0
    printed = capsys.readouterr().out
    assert "30, 30 of them with a position" in printed
    assert "every 2 m" in printed
    assert main(["map", "verify", str(street_map)]) == 0
    assert "checksums match" in capsys.readouterr().out


@pytest.mark.parametrize(("output", "why"), [("no/x", "No such file or directory"), (".", "Is a directory")])
def test_a_file_that_cannot_be_written(
    output: str, why: str, traverse: Path, street_map: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    replay = ["replay", str(traverse), "--map", str(street_map), "--all", "--sequence-length", "10"]
    path = tmp_path / output
    assert f"--output: {path}: cannot write it: {why}" in refused(capsys, *replay, "-o", str(path))


def test_what_needs_no_conversion_and_what_is_no_recording(
    traverse: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = "-o", str(tmp_path / "feed")
    assert "out: needs no conversion" in refused(capsys, "import", str(traverse), *output)
    assert "test_main.py: neither a feed folder nor a video" in refused(capsys, "import", __file__, *output)


@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_a_full_disk_behind_standard_output(unbuffered: str) -> None:
    command = [sys.executable, "-m", "edge", "config"]
    environment = {**os.environ, "PYTHONUNBUFFERED": unbuffered}
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(command, env=environment, stdout=full, stderr=subprocess.PIPE, check=False)
    assert done.returncode == 1
    assert done.stderr == b"lookback: No space left on device\n"


@pytest.mark.parametrize("command", [["map", "info"], ["home"], ["map", "verify"]])
def test_names_in_a_map_cannot_control_the_terminal(map_along: Callable[..., Path], command: list[str]) -> None:
    """Clear the screen, set the window's title, go back over the line."""
    along_m = np.arange(0.0, 100.0, 2.0)[:, None] * [0.0, 1.0]
    path = map_along(along_m, source="\x1b[2J\x1b]0;owned\x07evil\x9b31m\u202e{}")
    done = subprocess.run([sys.executable, "-m", "edge", *command, path], capture_output=True, text=True, check=False)
    printed = done.stdout + done.stderr
    assert printed.replace("\n", "").isprintable(), printed
    assert command[-1] == "verify" or "\\u001b[2J" in printed


def test_a_map_is_extended_without_its_images(
    street_map: Path, traverse: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(street_map, tmp_path / "grown.map")
    assert main(["map", "extend", str(tmp_path / "grown.map"), str(traverse)]) == 0
    assert "60 places in 2 segment(s)" in capsys.readouterr().out
    assert main(["map", "verify", str(tmp_path / "grown.map")]) == 0


def test_missing_feed(tmp_path: Path, street_map: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "nowhere: no such feed" in refused(
        capsys, "map", "build", str(tmp_path / "nowhere"), "-o", str(tmp_path / "m")
    )
    assert "nowhere: no such feed" in refused(capsys, "replay", str(tmp_path / "nowhere"), "--map", str(street_map))
    assert not (tmp_path / "m").exists()


def test_missing_and_truncated_map(
    traverse: Path, street_map: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "no such map" in refused(capsys, "replay", str(traverse), "--map", str(tmp_path / "nowhere"))
    shutil.copytree(street_map, tmp_path / "cut.map")
    os.truncate(tmp_path / "cut.map/descriptors.i8", 1000)
    printed = refused(capsys, "replay", str(traverse), "--map", str(tmp_path / "cut.map"))
    assert "descriptors.i8: 1000 bytes where the header says 138240" in printed


def test_a_map_of_another_model_or_other_regions(
    traverse: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config, street_map = tmp_path / "whole.toml", tmp_path / "street.map"
    config.write_text('[descriptor]\nmodel = "fc6"\n')
    assert main(["map", "build", str(traverse), "-o", str(street_map), "--config", str(config)]) == 0
    config.write_text("[descriptor]\nregion_width = 0.5\n")
    printed = refused(capsys, "replay", str(traverse), "--map", str(street_map), "--config", str(config))
    assert "made with regions left-right of width 0.4" in printed
    assert "[descriptor] is left-right of width 0.5" in printed

    from edge.reference_map.store import ModelKey, open_map
    from edge_plugins.mapping.builder import Place
    from tests.map_of import map_of

    original = open_map(street_map)
    other = ModelKey("other-network", "f" * 64, "fc6", 4096)
    raw = original.raw()
    map_of(tmp_path / "other.map", raw, [Place(row) for row in range(len(raw))], model=other)
    printed = refused(capsys, "replay", str(traverse), "--map", str(tmp_path / "other.map"))
    assert "made with model other-network (ffffffffffff, fc6)" in printed
    assert printed.rstrip().endswith("; name the map's by --model or in [descriptor] model")


def test_a_model_that_is_none(
    traverse: Path, street_map: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "noise.onnx").write_bytes(os.urandom(1000))
    printed = refused(
        capsys, "replay", str(traverse), "--map", str(street_map), "--model", str(tmp_path / "noise.onnx")
    )
    assert "noise.onnx" in printed


def test_malformed_config(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = tmp_path / "bad.toml"
    config.write_text("[sequence]\nlenght = 20\n")
    assert refused(capsys, "run", str(config)) == f"lookback: {config}: [sequence] unknown key `lenght`\n"
    assert main(["doctor", "--offline", str(config)]) == 78
    assert f"{config}: [sequence] unknown key `lenght`\n" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "there"),
    [
        ("check lookback.toml", "`lookback check` is now `lookback doctor --offline`"),
        ("check --default", "`lookback check --default` is now `lookback config --all`"),
        ("sim import kitti x", "`lookback sim import` is now `lookback import`"),
        ("sim drive x", "`lookback sim` is now `lookback dev sim`"),
        ("dev golden x", "`lookback dev golden` is now `lookback replay`"),
        (
            "map merge a b",
            "`lookback map merge` is gone: copy the maps of both folders into one, docs/mapping.md",
        ),
        ("map apply a b", "`lookback map apply` is gone: copy what is new with rsync, docs/fleet.md"),
        ("dev train x", "`lookback dev train` is gone: the source of version 0.3.0 has it"),
    ],
)
def test_a_command_of_an_older_version_says_where_it_went(
    words: str, there: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words.split()) == 2
    assert capsys.readouterr() == ("", f"lookback: {there}\n")


def test_options_out_of_range(traverse: Path, street_map: Path, capsys: pytest.CaptureFixture[str]) -> None:
    at = ("replay", str(traverse), "--map", str(street_map))
    assert "--sequence-length: expected `int` >= 2" in refused(capsys, *at, "--sequence-length", "1")
    assert "--spacing-m: expected `float` > 0" in refused(capsys, *at, "--spacing-m", "-1")
    assert "--confidence-from: expected `float` < 1" in refused(capsys, *at, "--confidence-from", "1.2")


def test_distance_that_a_feed_does_not_have(shared: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    feed = str(shared / "feeds/track_lap_a")
    printed = refused(capsys, "map", "build", feed, "-o", str(tmp_path / "m"), "--spacing-m", "2")
    assert "no distance_m and no positions" in printed
    assert list(tmp_path.iterdir()) == []


def test_unreadable_pictures_are_left_out_and_named(
    traverse: Path,
    street_map: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    caplog: pytest.LogCaptureFixture,
) -> None:
    spoiled = tmp_path / "spoiled"
    shutil.copytree(traverse, spoiled)
    (spoiled / "frames/000003.jpg").write_bytes(b"not a picture")
    (spoiled / "frames/000007.jpg").unlink()
    assert main(["replay", str(spoiled), "--map", str(street_map), "--sequence-length", "5", "--all"]) == 0
    frames = [json.loads(line)["frame"] for line in capsys.readouterr().out.splitlines()]
    assert frames == [row for row in range(30) if row not in (3, 7)]
    assert "000003.jpg" in caplog.text
    assert "000007.jpg" in caplog.text


def test_the_default_config_can_be_printed_and_used(
    street_map: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["config", "--all"]) == 0
    text = capsys.readouterr().out.replace("/var/lib/lookback/map", str(street_map))
    text = text.replace("# length = 40", "length = 15")
    (tmp_path / "lookback.toml").write_text(text)
    assert main(["doctor", "--offline", str(tmp_path / "lookback.toml")]) == 0
    assert "map of 30 places" in capsys.readouterr().out


def test_a_reader_that_goes_away_is_no_error(traverse: Path, street_map: Path) -> None:
    command = (
        f'"{sys.executable}" -um edge replay "{traverse}" --map "{street_map}" --sequence-length 2 --all | head -n 1'
    )
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
    assert done.stdout.count("\n") == 1
    assert done.stderr == ""


def test_version_and_usage(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["--version"])
    assert ended.value.code == 0
    assert capsys.readouterr().out == f"lookback {edge.__version__}\n"
    with pytest.raises(SystemExit) as ended:
        main(["replay"])
    assert ended.value.code == 2


def leaves(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    """The commands that have none below them."""
    below = [action.choices for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    if not below:
        yield parser
    for choices in below:
        for one in choices.values():
            yield from leaves(one)


def test_the_help_of_every_command_begins_with_a_sentence() -> None:
    commands = list(leaves(build_parser()))
    assert len(commands) > 40
    for command in commands:
        usage, sentence, *_ = command.format_help().split("\n\n")
        assert usage.startswith("usage: lookback ")
        assert re.match(r"[A-Z].*[a-z]", sentence) and not sentence.startswith("positional"), command.prog


@pytest.mark.parametrize(("hangs", "printed"), [(False, "finalized\n"), (True, "")])
def test_a_thread_that_hangs_in_a_driver_is_not_unwound(hangs: bool, printed: str) -> None:
    thread = "threading.Thread(target=time.sleep, args=(60,), daemon=True).start()" if hangs else "pass"
    code = (
        f"import atexit, sys, threading, time; {thread}; atexit.register(print, 'finalized');"
        " from edge.__main__ import command; sys.argv = ['lookback', '--version']; command()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True)
    assert done.stdout == f"lookback {edge.__version__}\n{printed}"


INTERRUPT_IMPORTS = """
import os, signal, sys
class Interrupt:
    def find_spec(self, name, *_):
        if name == "edge.commands.parser":
            os.kill(os.getpid(), signal.SIGINT)
signal.signal(signal.SIGINT, signal.{handler})
sys.meta_path.insert(0, Interrupt())
sys.argv[1:] = ["--version"]
from edge.__main__ import command
command()
"""


@pytest.mark.parametrize(
    ("handler", "code"), [("default_int_handler", -signal.SIGINT), ("SIG_IGN", 0)], ids=["caught", "ignored"]
)
def test_ctrl_c_while_modules_are_imported_prints_no_traceback(handler: str, code: int) -> None:
    """A shell ignores it for what it starts in the background, and so it stays."""
    script = INTERRUPT_IMPORTS.replace("{handler}", handler)
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (code, "")
    as_it_was = signal.default_int_handler, signal.SIG_IGN  # the latter where these tests run in the background
    assert signal.getsignal(signal.SIGINT) in as_it_was, "importing `main` changed it here"


def test_a_log_line_stands_above_a_bar() -> None:
    terminal = io.StringIO()
    handler = AboveBars(terminal)
    with tqdm(total=10, desc="building", file=terminal) as bar:
        bar.update(5)
        handler.emit(logging.makeLogRecord({"msg": "a line"}))
        bar.refresh()
    handler.emit(logging.makeLogRecord({"msg": "another"}))
    screen = [line.rpartition("\r")[2] for line in terminal.getvalue().split("\n")]
    assert [line for line in screen if "line" in line or "another" in line] == ["a line", "another"]
    assert "building" in terminal.getvalue().rpartition("a line")[2], "the bar is drawn again below"


def test_a_folder_without_maps_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "no map in it yet; make one with `lookback map build FEED -o" in refused(
        capsys, "map", "info", str(tmp_path)
    )


def test_a_level_of_the_log_that_is_none(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("LOOKBACK_LOG", "loud")
    assert refused(capsys, "config") == "lookback: LOOKBACK_LOG=loud: expected debug, info, warning, error\n"
