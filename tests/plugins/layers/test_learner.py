"""The daemon learns from its drives while the vehicle stands."""

from __future__ import annotations

import logging
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from edge.__main__ import main
from edge.reference_map import open_map_set
from edge_plugins.layers.learner import STOOD_NS, Learner, learn_command
from tests.plugins.layers.drives import MADE_S, Driven, build

Follow = Callable[[float, float | None], None]


@pytest.fixture
def marks(tmp_path: Path) -> Path:
    return tmp_path / "marks"


@pytest.fixture
def learner(marks: Path, request: pytest.FixtureRequest) -> Iterator[Learner]:
    one = Learner(["sh", "-c", f"echo begun >> {marks}; {request.param}"])
    yield one
    one.close()


def until(learner: Learner, now_ns: int, is_so: Callable[[], object]) -> None:
    ends_s = time.monotonic() + 10.0
    while not is_so():
        assert time.monotonic() < ends_s
        learner.follow(now_ns, 0.0, 0.3)


def begun(marks: Path) -> int:
    return len(marks.read_text().splitlines()) if marks.exists() else 0


@pytest.mark.parametrize("learner", ["exec sleep 60"], indirect=True)
def test_it_runs_only_while_the_vehicle_stands(learner: Learner, marks: Path) -> None:
    for speed_mps in (3.0, None, 0.0):
        learner.follow(10 * STOOD_NS, speed_mps, 0.3)
        learner.follow(11 * STOOD_NS - 1, speed_mps, 0.3)
    assert begun(marks) == 0
    until(learner, 11 * STOOD_NS, lambda: begun(marks))
    process = learner._process
    assert process is not None
    learner.follow(12 * STOOD_NS, 3.0, 0.3)
    assert process.returncode is not None, "ended as soon as the vehicle moves"
    learner.follow(13 * STOOD_NS, 0.0, 0.3)
    assert begun(marks) == 1
    until(learner, 14 * STOOD_NS, lambda: begun(marks) == 2)


@pytest.mark.parametrize(
    ("learner", "said"),
    [
        ("echo 4 of 8 drives", "learned: 4 of 8 drives"),
        ("echo no; echo disk full >&2; exit 78", "not learned: disk full"),
    ],
    indirect=["learner"],
)
def test_it_says_once_what_came_of_it(
    learner: Learner, marks: Path, said: str, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.INFO):
        learner.follow(0, 0.0, 0.3)
        until(learner, STOOD_NS, lambda: said in caplog.messages)
        learner.follow(10 * STOOD_NS, 0.0, 0.3)
    assert (caplog.messages, begun(marks)) == ([said], 1)


def test_no_module_of_the_working_folder_is_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor of the environment."""
    for name in ("edge/__init__.py", "edge/__main__.py", "msgspec.py", "sitecustomize.py"):
        (tmp_path / "here" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "here" / name).write_text(f"open({str(tmp_path / 'run')!r}, 'w')")
    monkeypatch.chdir(tmp_path / "here")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "here"))
    build(tmp_path / "maps" / "one", Driven(0, made_s=MADE_S))
    done = subprocess.run(learn_command(tmp_path / "maps", 2), capture_output=True, text=True, check=False)
    assert (done.returncode, (tmp_path / "run").exists()) == (0, False), done.stderr


def test_its_command_learns(tmp_path: Path) -> None:
    for number in range(3):
        build(tmp_path / f"{number}", Driven(number, made_s=MADE_S + number))
    command = learn_command(tmp_path, 2)
    assert main(command[command.index("map") :]) == 0
    assert len(open_map_set(tmp_path).names) == 2
