"""Whatever comes in: an error of ours in one line, or an answer; never a traceback, and never a hang."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable
from itertools import count
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import seed as seeded
from hypothesis import strategies as st

from edge.camera.newest import NewestFrame
from edge.camera.recorded import RecordedCamera
from edge.config import SHIPPED, Config, parse_config, section_kind
from edge.descriptor.model_file import FC6_FILE, read_model_file, resolve_model
from edge.descriptor.network import Network
from edge.errors import FrameError, LookbackError
from edge.feed import FeedImages, read_feed
from edge.recognition.recognizer import PlaceRecognizer
from edge.reference_map import MapSet
from edge.reference_map.store import open_map

CASES = [100, pytest.param(10_000, marks=pytest.mark.soak)]
Fuzz = Callable[[Callable[..., None], Any], None]


@pytest.fixture(params=CASES)
def fuzz(request: pytest.FixtureRequest, seed: int, figures: Callable[[str], None]) -> Fuzz:
    """Tries a function on many made-up inputs; one that takes over ten seconds is a hang."""

    def run(check: Callable[..., None], strategy: Any) -> None:
        limits = settings(
            max_examples=request.param,
            deadline=10_000,
            database=None,
            suppress_health_check=list(HealthCheck),
        )
        seeded(seed)(limits(given(strategy)(check)))()  # type: ignore[no-untyped-call]
        figures(f"{request.param} cases")

    return run


def one_line(work: Callable[[], object], name: str = "") -> None:
    """Do it; only an error of ours, in one line for each mistake that names the thing, is allowed."""
    try:
        work()
    except LookbackError as error:
        assert all(line.startswith(name) for line in str(error).splitlines()), str(error)


def mutated(whole: bytes, *, most: int = 8) -> st.SearchStrategy[bytes]:
    """A file with some stretches replaced, removed or put in twice."""
    where = st.integers(0, max(0, len(whole) - 1))
    change = st.tuples(where, st.integers(0, 16), st.binary(max_size=16))

    def apply(changes: list[tuple[int, int, bytes]]) -> bytes:
        data = bytearray(whole)
        for at, length, new in changes:
            data[at : at + length] = new
        return bytes(data)

    return st.lists(change, min_size=1, max_size=most).map(apply)


def test_config(fuzz: Fuzz) -> None:
    own = {field.name: field.type for field in msgspec.structs.fields(Config) if field.name != "plugins"}
    sections = {**own, **{name: section_kind(name, [point]) for name, point in SHIPPED.items()}}
    keys = [(name, field.name) for name, kind in sections.items() for field in msgspec.structs.fields(kind)]
    value = st.one_of(
        st.integers(-(2**70), 2**70).map(str),
        st.floats().map(repr),
        st.text(max_size=30).map(json.dumps),
        st.sampled_from(["true", "[]", "[1, 2]", "{}", "[[1]]", "1979-05-27", "''", "nan", "-inf", '"\\u0000"']),
    )
    line = st.tuples(st.sampled_from(keys), value).map(lambda item: f"[{item[0][0]}]\n{item[0][1]} = {item[1]}\n")
    text = st.one_of(st.text(max_size=200), line, st.lists(line, max_size=3).map("".join))
    path = Path("/etc/lookback/lookback.toml")
    fuzz(lambda text: one_line(lambda: parse_config(text, path), str(path)), text)


def test_feed(fuzz: Fuzz, street: Path, tmp_path: Path) -> None:
    feed = street / "feed"
    toml, table = (feed / "feed.toml").read_bytes(), b"\n".join((feed / "frames.csv").read_bytes().split(b"\n")[:6])
    (tmp_path / "frames").mkdir()
    for name in ("000000.jpg", "000001.jpg"):
        (tmp_path / "frames" / name).write_bytes((feed / "frames" / name).read_bytes())

    def play(files: tuple[bytes, bytes]) -> None:
        (tmp_path / "feed.toml").write_bytes(files[0])
        (tmp_path / "frames.csv").write_bytes(files[1])
        images = FeedImages(read := read_feed(tmp_path))
        for index in range(min(3, len(read.rows))):
            one_line(lambda index=index: images.read(index))  # type: ignore[misc]

    files = st.tuples(st.one_of(st.just(toml), mutated(toml), st.binary(max_size=99)), mutated(table))
    fuzz(lambda files: one_line(lambda: play(files), str(tmp_path)), files)


def test_map_header(fuzz: Fuzz, make_map: Callable[..., Path], tmp_path: Path) -> None:
    path = make_map(tmp_path / "small.map")
    good = json.loads((path / "map.json").read_bytes())
    number: st.SearchStrategy[Any] = st.one_of(
        st.integers(-(2**63), 2**63), st.floats(), st.text(max_size=5), st.none(), st.just([])
    )
    places: list[list[Any]] = [
        ["places"],
        ["version"],
        ["format"],
        ["files", "raw.f16", "bytes"],
        ["files", "raw.f16", "sha256"],
    ]
    places += [["segments", 0, "start"], ["segments", 0, "end"], ["segments", 0, "view"], ["regions", "width"]]
    places += [["model", "dimensions"], ["model", "sha256"], ["regions", "kind"], ["sampling", "spacing_m"], ["files"]]

    def sealed(where: list[Any], value: Any) -> bytes:
        """With a checksum that holds: somebody means it."""
        header = json.loads(json.dumps(good)) | {"header_sha256": ""}
        inner: Any = header
        for key in where[:-1]:
            inner = inner[key]
        inner[where[-1]] = value
        digest = hashlib.sha256(msgspec.json.encode(header)).hexdigest()
        return msgspec.json.format(msgspec.json.encode(header | {"header_sha256": digest}), indent=1)

    data = st.one_of(
        st.builds(sealed, st.sampled_from(places), number), mutated((path / "map.json").read_bytes()), st.binary()
    )

    def check(data: bytes) -> None:
        (path / "map.json").write_bytes(data)
        one_line(lambda: open_map(path, every_file=True), str(path))

    fuzz(check, data)


def test_model_file(fuzz: Fuzz, tmp_path: Path) -> None:
    whole = resolve_model(None, FC6_FILE).read_bytes()
    path = tmp_path / "model.onnx"
    # The graph and its metadata are at both ends; between them lie 40 MB of weights.
    ends = whole[:4096] + whole[-4096:]
    data = st.one_of(mutated(ends), st.binary(max_size=4096))

    def check(data: bytes) -> None:
        path.write_bytes(data)
        one_line(lambda: Network(read_model_file(path)), str(path))

    fuzz(check, data)


def test_frames(fuzz: Fuzz, street: Path, grid: Network) -> None:
    class Flat:
        """A network that costs nothing: a descriptor of the mean colors."""

        info, size, path = grid.info, grid.size, grid.path

        def describe(self, images: np.ndarray) -> np.ndarray:
            means = images.reshape(len(images), -1).mean(axis=1, keepdims=True, dtype=np.float32)
            descriptors: np.ndarray = np.maximum(np.sin(means + np.arange(self.info.dimensions, dtype=np.float32)), 0)
            return descriptors

    config = msgspec.convert({"sequence": {"length": 3}}, Config)
    recognizer = PlaceRecognizer(Flat(), MapSet.of(open_map(street / "map")), config)  # type: ignore[arg-type]
    numbers = count()

    def check(case: tuple[int, int, int, int]) -> None:
        height, width, level, stamp_ns = case
        rng = np.random.default_rng(next(numbers))
        image = rng.integers(0, level + 1, (height, width, 3)).astype(np.uint8)
        match = recognizer.observe(image, stamp_ns)
        assert match is None or (math.isfinite(match.uniqueness) and 0 <= match.place < 80)

    side = st.integers(1, 200)
    fuzz(check, st.tuples(side, side, st.integers(0, 255), st.integers(-(2**63), 2**63 - 1)))


def test_pictures_of_a_feed(fuzz: Fuzz, street: Path) -> None:
    """Damaged files are bad frames; the camera's thread goes on to the next."""
    file = street / "feed/frames/000000.jpg"
    whole = file.read_bytes()
    feed = read_feed(street / "feed")
    images = FeedImages(feed)

    def check(data: bytes) -> None:
        file.write_bytes(data)
        try:
            assert images.read(0).shape == (120, 160, 3)
        except FrameError as error:
            assert str(file) in str(error)

    try:
        fuzz(check, st.one_of(mutated(whole), st.integers(0, len(whole)).map(lambda length: whole[:length])))
        file.write_bytes(b"")
        newest = NewestFrame(lambda: RecordedCamera(feed, lambda: 0, lambda seconds: None))
        while not newest.ended:
            newest.take(1.0)
        assert (newest.health.bad, newest.health.delivered) == (1, 79)
        newest.close()
    finally:
        file.write_bytes(whole)
