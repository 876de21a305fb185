from __future__ import annotations

from pathlib import Path

import pytest

from edge.errors import ConfigError
from sim.world.scenario import load_scenario


def write(folder: Path, text: str) -> Path:
    path = folder / "drive.toml"
    path.write_text(text)
    return path


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
