"""One config file, checked whole; every mistake is one line that names the file and the key."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest
from msgspec.structs import replace

from edge.config import (
    DEFAULT_TOML,
    FIRST_NETWORK,
    SHIPPED,
    START_TOML,
    Config,
    load_config,
    parse_config,
)
from edge.errors import ConfigError
from edge.toml_file import toml_values

HERE = Path("/etc/lookback/lookback.toml")


def test_the_commented_default_has_every_key_at_its_default() -> None:
    written = toml_values(DEFAULT_TOML.read_text(encoding="utf-8"), DEFAULT_TOML)
    plugins = {name: point.load()() for name, point in SHIPPED.items()}
    known = msgspec.json.decode(msgspec.json.encode(Config(plugins=plugins)))
    known |= known.pop("plugins")
    assert written == {name: keys for name, keys in known.items() if keys}


def test_every_line_of_the_default_is_explained() -> None:
    for line in DEFAULT_TOML.read_text(encoding="utf-8").splitlines():
        if "=" in line and not line.startswith(("path", "#")):
            assert "#" in line, line


def test_the_config_to_start_from_has_few_keys_as_the_whole_one_explains_them() -> None:
    lines = START_TOML.read_text(encoding="utf-8").splitlines()
    known = set(DEFAULT_TOML.read_text(encoding="utf-8").splitlines())
    assert [line for line in lines if line and not line.startswith("#") and line not in known] == [
        line for line in lines if line.startswith(f'model = "{FIRST_NETWORK}"')
    ]
    assert 10 <= sum(len(keys) for keys in toml_values("\n".join(lines), HERE).values()) <= 15
    start, whole = load_config(START_TOML), load_config(DEFAULT_TOML)
    assert start.descriptor == replace(whole.descriptor, model=FIRST_NETWORK)
    assert replace(start, plugins={}, descriptor=whole.descriptor) == replace(whole, plugins={})
    assert all(start.of(type(section)) == section for section in whole.plugins.values())


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("[camera]\nfsp = 15.0", "[camera] unknown key `fsp`"),
        ("[camra]\nfps = 15.0", "unknown section `camra`"),
        ('[camera]\nfps = "fast"', "[camera] fps: expected a number, got text in quotes"),
        ("[camera]\nfps = 0", "[camera] fps: expected a number > 0"),
        ("[camera]\nfourcc = 'MJPEG'", "[camera] fourcc: expected text in quotes matching"),
        ("[camera]\nwidth = 640.5", "[camera] width: expected a whole number, got a number"),
        ("[camera]\ndistortion = [0.1]", "[camera] distortion: a pinhole lens has k1, k2, p1, p2 and perhaps k3"),
        ("[camera]\nlens = 'fisheye'", "[camera] distortion: a fisheye lens has k1, k2, k3, k4 (OpenCV), not []"),
        (
            "[camera]\ndistortion = [-0.2, 0.1, 0.0, 0.0]\ncrop = [0.1, 0.0, 0.0, 0.0]",
            "[camera] crop: with a lens it must be the same left and right",
        ),
        ("[sequence]\nlength = 1", "[sequence] length: expected a whole number >= 2"),
        ("[sequence]\nlength = true", "[sequence] length: expected a whole number, got true or false"),
        (
            "[sequence]\ndirections = 'backwards'",
            '[sequence] directions: "backwards" is none of "both", "forward", "reverse"',
        ),
        ("[acceptance]\nuniqueness_min = 0.5", "[acceptance] uniqueness_min: expected a number >= 1"),
        ("sequence = 3", "[sequence] expected a section, got a whole number"),
        ("[camera\n", "not TOML"),
        (
            "[mapping]\nfolder = 'm'\n[sampling]\nby = 'time'",
            '[mapping] folder: mapping needs [sampling] by = "distance"',
        ),
        ("[motion]\nuse = 'report'", "[camera] fov_deg: is not set, and [motion] needs it"),
        ("[mapping.camera]\nview = 'rear'", "[mapping] folder: is empty; name the folder of maps"),
        ("[mapping]\nfolder = 'm'\n[mapping.camera]\nfps = 0", "[mapping] camera.fps: expected a number > 0"),
        ("[camera]\nfps = 1\nfps = 2", "not TOML"),
        ("[tracking]\ndrift_percent = 3", "[tracking] unknown key `drift_percent`"),
        ("[gates]\ndoubted_gps = 'tell'", '[gates] doubted_gps: "tell" is none of "report", "send", "switch"'),
    ],
)
def test_every_mistake_is_one_line_with_file_and_key(text: str, told: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_config(text, HERE)
    message = str(caught.value)
    assert message.startswith(f"{HERE}: ")
    assert told in message
    assert "\n" not in message


def test_an_old_name_of_a_key_works_and_says_so_once(caplog: pytest.LogCaptureFixture) -> None:
    assert parse_config("[rig]\nsigma_across_m = 4", HERE).rig.sigma_cross_track_m == 4
    assert caplog.messages == [
        f"{HERE}: [rig] sigma_across_m is now sigma_cross_track_m; the old name works in this version only: rename it"
    ]
    with pytest.raises(ConfigError, match=r"\[rig\] sigma_across_m: the old name of sigma_cross_track_m.*remove it"):
        parse_config("[rig]\nsigma_across_m = 4\nsigma_cross_track_m = 3", HERE)
    with pytest.raises(ConfigError, match="rig"):
        parse_config("rig = 'sigma_across_m'", HERE)


def test_each_mistake_has_its_line() -> None:
    text = "[camera]\nfps = 'fast'\nwidth = 3\n[gates]\nmax_movem = 3\n[mapping.camera]\nfps = 9"
    with pytest.raises(ConfigError) as caught:
        parse_config(text, HERE)
    assert str(caught.value).splitlines() == [
        f"{HERE}: [camera] fps: expected a number, got text in quotes",
        f"{HERE}: [camera] width: expected a whole number >= 16",
        f"{HERE}: [gates] unknown key `max_movem`",
    ], "and not the rule between keys, which may be broken only because one of them was not read"


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


@pytest.mark.parametrize(
    ("text", "frames"),
    [
        ("", 40),
        ("[sampling]\nspacing_m = 1.0", 80),
        ("[sampling]\nspacing_m = 1.5", 54),
        ("[sampling]\nspacing_m = 0.1", 80),
        ("[sampling]\nspacing_m = 6.0", 40),
        ('[sampling]\nby = "frames"\nspacing_m = 1.0', 40),
        ("[sampling]\nspacing_m = 1.0\n[sequence]\nlength = 20", 20),
    ],
)
def test_a_sequence_spans_80_m_unless_the_file_says_otherwise(text: str, frames: int) -> None:
    assert parse_config(text, HERE).sequence_frames == frames
