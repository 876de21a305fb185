"""What is handed around stays in its folder, and is what its checksum says; the network is where the config has it."""

from __future__ import annotations

import ast
import json
import os
import re
import shutil
import struct
import subprocess
import sys
import zlib
from collections.abc import Callable
from pathlib import Path

import msgspec
import onnx
import pytest

from edge.__main__ import main
from edge.descriptor.network import Network
from edge.errors import FeedError, FrameError, MapError
from edge.feed import FeedImages, read_feed, read_picture
from edge.reference_map.store import HEADER, encode_header, open_map, read_header
from sim.datasets import open_dataset
from sim.datasets.found import find_kind
from sim.maps.keys import make_key, sign_map
from sim.model_tools.import_command import write
from tests.common import ROOT

OUT = ["../secret", "/etc/passwd", "frames/../../secret", "./../secret", "a\0b", "frames/..", "..", ""]


@pytest.fixture
def secret(tmp_path: Path) -> Path:
    """A file beside the folder that is handed around."""
    (tmp_path / "secret").write_bytes(b"not for you")
    return tmp_path / "secret"


@pytest.mark.parametrize("name", OUT, ids=repr)
@pytest.mark.parametrize("kind", ["picture", "video"])
def test_a_feed_names_nothing_outside_its_folder(
    kind: str, name: str, street: Path, tmp_path: Path, secret: Path
) -> None:
    feed = tmp_path / "feed"
    shutil.copytree(street / "feed", feed)
    if kind == "picture":
        rows = (feed / "frames.csv").read_text().replace("frames/000003.jpg", f'"{name}"')
        (feed / "frames.csv").write_text(rows)
    else:
        text = (feed / "feed.toml").read_text()
        assert 'video = ""' in text
        (feed / "feed.toml").write_text(text.replace('video = ""', f"video = {msgspec.json.encode(name).decode()}"))
    if kind == "video" and not name:
        return  # no video: pictures
    with pytest.raises(FeedError) as refusal:
        read_feed(feed)
    assert "\n" not in str(refusal.value)
    assert str(feed) in str(refusal.value)
    assert "not for you" not in str(refusal.value)


@pytest.mark.parametrize("name", ["feed.toml", "frames.csv", "frames/000003.jpg"])
@pytest.mark.parametrize("how", ["link", "pipe"])
def test_a_feeds_files_lie_in_its_folder(how: str, name: str, street: Path, tmp_path: Path) -> None:
    """A pipe held up `map build` without end."""
    feed = tmp_path / "feed"
    shutil.copytree(street / "feed", feed)
    shutil.move(feed / name, tmp_path / "elsewhere")
    if how == "link":
        (feed / name).symlink_to(tmp_path / "elsewhere")
    else:
        os.mkfifo(feed / name)
    with pytest.raises((FeedError, FrameError), match=f"{feed / name}: not a regular file of this feed"):
        FeedImages(read_feed(feed)).read(3)


@pytest.mark.parametrize("name", ["a.jpg", "a.mp4", "track.csv"])
@pytest.mark.parametrize("kind", ["found", "geotagged"])
def test_no_pipe_holds_up_an_import(kind: str, name: str, tmp_path: Path) -> None:
    """Of whichever reader: it would wait without end."""
    pytest.importorskip("PIL", reason="needs the extra `import`")
    os.mkfifo(tmp_path / name)
    with pytest.raises(FeedError, match=f"{tmp_path / name}: not a regular file; remove it from the recording"):
        find_kind(tmp_path) if kind == "found" else open_dataset(kind, tmp_path)


def test_a_picture_of_another_program_is_no_pipe(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.jpg")
    with pytest.raises(FrameError, match="not a regular file"):
        read_picture(tmp_path / "a.jpg")


def png(width: int, height: int) -> bytes:
    """One that is all black, of few bytes however large."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    packer = zlib.compressobj(9)
    rows = b"".join(packer.compress(bytes(1 + (width + 7) // 8)) for _ in range(height)) + packer.flush()
    head = struct.pack(">IIBBBBB", width, height, 1, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")


READ = """
import resource, sys
from pathlib import Path
import edge.camera.v4l2  # which loads OpenCV before anything of the feed
from edge.errors import FrameError
from edge.feed import read_picture
try:
    read_picture(Path(sys.argv[1]))
except FrameError as error:
    print(error)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


def test_the_size_of_a_picture_is_read_before_its_pixels(tmp_path: Path) -> None:
    """30,000 x 30,000 took 7.8 GB before it was refused."""
    (tmp_path / "large.png").write_bytes(png(20_000, 20_000))
    (tmp_path / "small.png").write_bytes(png(20, 20))
    said = {}
    for name in ("large", "small"):
        command = [sys.executable, "-c", READ, str(tmp_path / f"{name}.png")]
        *error, peak_kb = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
        said[name] = error, int(peak_kb)
    assert said["small"][0] == []
    assert said["large"][0] == [
        f"{tmp_path / 'large.png'}: more than 67108864 pixels, which OPENCV_IO_MAX_IMAGE_PIXELS allows"
    ]
    assert said["large"][1] - said["small"][1] < 50_000, "kB"


@pytest.mark.parametrize("where", ["feed.toml", "frames.csv", "map header", "map folder"])
def test_a_name_forges_no_line_of_output(
    where: str, street: Path, make_map: Callable[..., Path], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    name = "x\nlookback: all is well"
    feed = tmp_path / "feed"
    shutil.copytree(street / "feed", feed)
    command = ["map", "build", str(feed), "-o", str(tmp_path / "out")]
    if where == "feed.toml":
        text = (feed / "feed.toml").read_text()
        (feed / "feed.toml").write_text(re.sub("(?m)^name = .*", f"name = {json.dumps(name)}", text))
    elif where == "frames.csv":
        rows = (feed / "frames.csv").read_text().replace("frames/000003.jpg", f'"{name}"')
        (feed / "frames.csv").write_text(rows)
    else:
        folder = tmp_path / "maps" / (name if where == "map folder" else "one")
        folder.parent.mkdir()
        shutil.copytree(make_map(tmp_path / "made"), folder)
        make_map(tmp_path / "maps" / "another")
        command = ["map", "info", str(folder.parent)]
        if where == "map header":
            header = read_header(folder)
            segments = tuple(msgspec.structs.replace(one, source=name) for one in header.segments)
            changed = msgspec.structs.replace(header, segments=segments, header_sha256="")
            (folder / HEADER).write_bytes(encode_header(changed))
            command = ["map", "info", str(folder)]
    main(command)
    said = capfd.readouterr()
    assert "all is well" in said.out + said.err or where in ("feed.toml", "map header"), "it is shown, spelled out"
    assert "\nlookback: all is well" not in said.out + said.err


@pytest.mark.parametrize("name", ["descriptors.i8", "thumbnails.jpgs", "map.json"])
@pytest.mark.parametrize("how", ["link", "pipe"])
def test_a_maps_files_are_plain_files_of_its_folder(
    how: str, name: str, make_map: Callable[..., Path], tmp_path: Path
) -> None:
    """A link to the very same bytes elsewhere is refused, and a pipe, which would be waited for without end."""
    path = make_map(tmp_path / "map")
    shutil.move(path / name, tmp_path / "elsewhere")
    if how == "link":
        (path / name).symlink_to(tmp_path / "elsewhere")
    else:
        os.mkfifo(path / name)
    with pytest.raises(MapError, match=f"{path / name}: not a regular file"):
        open_map(path, every_file=True)


@pytest.mark.parametrize("name", ["../secret", "/etc/passwd", "events.jsonl"])
def test_a_map_header_names_no_other_files(name: str, make_map: Callable[..., Path], tmp_path: Path) -> None:
    path = make_map(tmp_path / "map")
    header = read_header(path)
    files = {**header.files, name: header.files["raw.f16"]}
    (path / HEADER).write_bytes(encode_header(msgspec.structs.replace(header, files=files, header_sha256="")))
    with pytest.raises(MapError, match="files: not the list of files of a map"):
        open_map(path)


def refused(config: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """The daemon's one line."""
    assert main(["run", str(config)]) == 78
    line = capsys.readouterr().err
    assert line.count("\n") == 1
    return line


@pytest.mark.parametrize("how", ["link", "pipe", "large"])
def test_a_signature_is_a_small_plain_file(
    how: str, street: Path, write_config: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("cryptography", reason="needs the extra `signing`")
    path = tmp_path / "signed.map"
    shutil.copytree(street / "map", path)
    public = make_key(tmp_path / "owner")
    sign_map(path, tmp_path / "owner")
    signature = path / f"{HEADER}.sig"
    if how == "large":
        signature.write_bytes(signature.read_bytes() + b" " * 10**6)
    else:
        shutil.move(signature, tmp_path / "elsewhere")
    if how == "link":
        signature.symlink_to(tmp_path / "elsewhere")
    elif how == "pipe":
        os.mkfifo(signature)
    line = refused(write_config(map={"path": str(path), "require_signature_by": str(public)}), capsys)
    assert ("signature is not that of" if how == "large" else "not a regular file") in line


def test_another_model_is_refused_by_its_checksum(
    write_config: Callable[..., Path], grid: Network, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The same network to the last weight, with one remark more: another file, and so another model."""
    shipped = grid.path
    for file in shipped.parent.glob("*.onnx"):
        shutil.copy(file, tmp_path)
    config = write_config(descriptor={"model": shipped.name})
    model = onnx.load(tmp_path / shipped.name)
    model.doc_string = "a remark"
    write(model, tmp_path / shipped.name)
    why = refused(config, capsys)
    assert f"made with model {grid.info.name} ({grid.info.sha256[:12]}" in why
    assert "but the model here is" in why


NETWORK = {"socket", "socketserver", "http", "urllib", "ssl", "ftplib", "smtplib", "asyncio", "xmlrpc", "requests"}
NETWORK |= {"serial", "httpx", "aiohttp", "websockets", "telnetlib", "imaplib", "poplib", "multiprocessing", "uvicorn"}
SPEAKS = {
    "edge/health/monitor.py": {"socket"},  # to systemd, where NOTIFY_SOCKET says
    "edge/telemetry/link.py": {"socket", "serial"},  # to [telemetry] connection and links
    "edge/telemetry/port.py": {"socket"},  # the names of their hosts
    "edge_plugins/doctor/computer.py": {"serial"},  # which ports there are
    "edge_plugins/nmea/outlets.py": {"socket"},  # on [nmea] bind and port
    "edge_plugins/page/connections.py": {"asyncio", "uvicorn"},  # limits on what the server accepts
    "edge_plugins/page/server.py": {"asyncio", "socket", "uvicorn"},  # on [page] host and port
}


def imported(file: Path) -> set[str]:
    nodes = list(ast.walk(ast.parse(file.read_text(encoding="utf-8"))))
    names = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    names |= {node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)}
    return {name.split(".")[0] for name in names}


def test_only_what_the_config_names_speaks_to_a_network() -> None:
    files = [file for part in ("edge", "edge_plugins") for file in sorted((ROOT / part).rglob("*.py"))]
    assert len(files) > 150
    found = {str(file.relative_to(ROOT)): imported(file) & NETWORK for file in files}
    assert {file: names for file, names in found.items() if names} == SPEAKS
