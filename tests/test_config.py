"""One config file, checked whole; every mistake is one line that names the file and the key."""

from __future__ import annotations

from pathlib import Path

import pytest

from edge.config import DEFAULT_TOML, Config, SequenceConfig, checked_option, load_config, parse_config
from edge.errors import ConfigError

HERE = Path("/etc/lookback/lookback.toml")


def test_the_commented_default_has_every_key_at_its_default() -> None:
    import msgspec

    from edge.toml_file import tomllib

    written = tomllib.loads(DEFAULT_TOML.read_text(encoding="utf-8"))
    assert written == msgspec.json.decode(msgspec.json.encode(Config()))


def test_every_line_of_the_default_is_explained() -> None:
    for line in DEFAULT_TOML.read_text(encoding="utf-8").splitlines():
        if "=" in line and not line.startswith(("path", "#")):
            assert "#" in line, line


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("[camera]\nfsp = 15.0", "[camera] unknown key `fsp`"),
        ("[camra]\nfps = 15.0", "unknown section `camra`"),
        ('[camera]\nfps = "fast"', "[camera] fps: expected `float`, got `str`"),
        ("[camera]\nfps = 0", "[camera] fps: expected `float` > 0"),
        ("[camera]\nfourcc = 'MJPEG'", "[camera] fourcc: expected `str` matching"),
        ("[camera]\nwidth = 640.5", "[camera] width: expected `int`, got `float`"),
        ("[sequence]\nlength = 1", "[sequence] length: expected `int` >= 2"),
        ("[sequence]\nlength = true", "[sequence] length: expected `int`, got `bool`"),
        ("[sequence]\ndirections = 'backwards'", "[sequence] directions: invalid enum value 'backwards'"),
        ("[acceptance]\nuniqueness_min = 0.5", "[acceptance] uniqueness_min: expected `float` >= 1"),
        ("sequence = 3", "[sequence] expected `object`, got `int`"),
        ("[camera\n", "not TOML"),
        (
            "[mapping]\nfolder = 'm'\n[sampling]\nby = 'time'",
            '[mapping] folder: mapping needs [sampling] by = "distance"',
        ),
        ("[mapping.camera]\nview = 'rear'", "[mapping] folder: is empty; name the folder of maps"),
        ("[mapping]\nfolder = 'm'\n[mapping.camera]\nfps = 0", "[mapping] camera.fps: expected `float` > 0"),
        (
            "[mapping]\nfolder = 'm'\nrecognize = true",
            "[mapping] recognize: needs a second camera; add [mapping.camera]",
        ),
        (
            "[descriptor]\nregions = 'whole'\n[mapping]\nfolder = 'm'\nrecognize = true\n[mapping.camera]\nfps = 9",
            '[mapping] recognize: needs [descriptor] regions = "left-right"',
        ),
        ("[camera]\nfps = 1\nfps = 2", "not TOML"),
    ],
)
def test_every_mistake_is_one_line_with_file_and_key(text: str, told: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_config(text, HERE)
    message = str(caught.value)
    assert message.startswith(f"{HERE}: ")
    assert told in message
    assert "\n" not in message


def test_a_file_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"missing\.toml: cannot read it: No such file"):
        load_config(tmp_path / "missing.toml")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(ConfigError, match=r"binary\.toml: not UTF-8"):
        load_config(tmp_path / "binary.toml")


def test_paths_are_relative_to_the_file() -> None:
    config = parse_config("[map]\npath = 'maps/a'\n[telemetry]\njournal = '/var/log/x'\n", HERE)
    assert config.map.path == "/etc/lookback/maps/a"
    assert config.telemetry.journal == "/var/log/x"
    assert config.descriptor.model == ""  # "" stays the shipped model


def test_an_option_out_of_range_names_the_option() -> None:
    assert checked_option(SequenceConfig(), "--sequence-length", length=40).length == 40
    with pytest.raises(ConfigError, match=r"^--sequence-length: expected `int` >= 2$"):
        checked_option(SequenceConfig(), "--sequence-length", length=0)
