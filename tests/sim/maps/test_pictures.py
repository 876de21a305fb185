"""Maps without the small pictures of their places: built so, or copied so."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from edge.__main__ import main
from edge.reference_map import open_map
from edge.reference_map.store import THUMBNAILS


@pytest.fixture(scope="module")
def street(make_street: Callable[..., Path]) -> Path:
    return make_street(range(30))


def test_a_published_map_is_the_same_without_pictures(
    street: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given, without, with_them = street / "map", tmp_path / "published", tmp_path / "with"
    assert main(["map", "publish", str(given), "-o", str(without)]) == 0
    assert "published: 30 places, without pictures" in capsys.readouterr().out
    assert main(["map", "publish", str(given), "-o", str(with_them), "--pictures"]) == 0
    assert main(["map", "verify", str(without)]) == main(["map", "verify", str(with_them)]) == 0
    assert (without / THUMBNAILS).read_bytes() == b"" and (given / THUMBNAILS).stat().st_size > 0
    old, new, same = (open_map(path, every_file=True) for path in (given, without, with_them))
    assert new.thumbnail(3) == b"" and same.thumbnail(3) == old.thumbnail(3) and old.thumbnail(3) != b""
    assert new.header.tile is None and new.header.segments == old.header.segments
    for one in (new, same):
        assert np.array_equal(one.raw(), old.raw()) and np.array_equal(one.descriptors, old.descriptors)
        assert one.places["lat_deg"].tolist() == old.places["lat_deg"].tolist()
    assert main(["map", "publish", str(given), "-o", str(without)]) != 0
    assert "published: already exists; name another folder" in capsys.readouterr().err


def test_a_map_that_is_built_by_a_config_that_keeps_none_has_none(street: Path, tmp_path: Path) -> None:
    sizes = {}
    for keeps in ("true", "false"):
        config = tmp_path / f"{keeps}.toml"
        config.write_text(f"[camera]\nkeep_pictures = {keeps}\n")
        made = ["map", "build", str(street / "feed"), "-o", str(tmp_path / keeps), "--config", str(config)]
        assert main([*made, "--no-keypoints"]) == 0
        sizes[keeps] = (tmp_path / keeps / THUMBNAILS).stat().st_size
    assert sizes["true"] > 0 and sizes["false"] == 0
