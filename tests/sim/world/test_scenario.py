from __future__ import annotations

from pathlib import Path

import pytest

from edge.errors import ConfigError
from sim.world.scenario import Scenario, load_scenario


def write(folder: Path, text: str) -> Path:
    path = folder / "drive.toml"
    path.write_text(text)
    return path


def test_an_empty_file_is_the_default(tmp_path: Path) -> None:
    assert load_scenario(write(tmp_path, "")) == Scenario()


def test_keys_are_read_and_processes_that_share_a_file_agree(tmp_path: Path) -> None:
    path = write(tmp_path, 'seed = 4\nlength_m = 400.0\ndirection = "reverse"\nlight = "night"\nepoch_ns = 17\n')
    one, two = load_scenario(path), load_scenario(path)
    assert (one.seed, one.direction, one.light, one.epoch_ns) == (4, "reverse", "night", 17)
    assert one.drive().pose(12.5) == two.drive().pose(12.5)


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("speed = 3", "`speed`"),
        ('seed = "one"', "seed"),
        ("seed = -1", "seed"),
        ("length_m = 10.0", "length_m"),
        ('light = "fog"', "light"),
        ('view = "left"', "view"),
        ("fov_deg = 179.0", "fov_deg"),
        ("width = 4", "width"),
        ("seed = ", "not TOML"),
    ],
)
def test_what_is_wrong_is_one_line_with_file_and_key(tmp_path: Path, text: str, key: str) -> None:
    path = write(tmp_path, text)
    with pytest.raises(ConfigError) as caught:
        load_scenario(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert key in message
    assert "\n" not in message
