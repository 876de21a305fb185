"""The secrets of a config stand nowhere else: not in logs, errors, the journal, the page, metrics or a bundle."""

from __future__ import annotations

import contextlib
import os
import re
import socket
import threading
import urllib.error
import urllib.request
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import tomli_w

from edge.__main__ import main
from tests.udp_port import free_port

PASSWORD, QUERY, ARGUMENT = "p4ss-of:camera", "q7uery-secret", "a2rgument-secret"
KEY = bytes(range(65, 97))
SECRETS = [PASSWORD, QUERY, ARGUMENT, KEY.hex(), KEY.decode()]
"""Made to be found: no other text has them."""
AT = f"admin:{PASSWORD}@127.0.0.1"
CAMERAS = {
    "nobody answers": f"rtsp://{AT}:9/main?auth={QUERY}",
    "in its path": f"rtsp://127.0.0.1:9/user=admin_password={QUERY}_channel=1_stream=0.sdp",
    "not permitted": f"http://{AT}:PORT/video?token={QUERY}",
    "no such host": f"rtsp://admin:{PASSWORD}@no-such-host.invalid/main?token={QUERY}",
    "a command that fails": f"exec:sh -c 'echo cannot open rtsp://{AT}/ >&2; exit 3' --password {ARGUMENT}",
    "no such command": f"exec:no-such-command --password {ARGUMENT} rtsp://{AT}/",
}


@pytest.fixture(scope="module")
def refusing_server() -> Iterator[int]:
    """The port of a camera that answers 401 to all."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answer() -> None:
            with contextlib.suppress(OSError):
                while True:
                    with server.accept()[0] as client:
                        client.recv(4096)
                        client.sendall(b"HTTP/1.1 401 Unauthorized\r\nContent-Length: 0\r\n\r\n")

        threading.Thread(target=answer, daemon=True).start()
        yield int(server.getsockname()[1])


@pytest.fixture
def write(tmp_path: Path, street: Path, refusing_server: int) -> Callable[..., Path]:
    """Writes a config with each kind of secret; lines of it are replaced by others."""

    def write_one(camera: str, replaced: str = "", by: str = "") -> Path:
        device = CAMERAS[camera].replace("PORT", str(refusing_server))
        key, maps = tmp_path / "mavlink.key", tmp_path / "maps"
        key.write_text(KEY.hex())
        key.chmod(0o600)
        maps.mkdir(exist_ok=True)
        with contextlib.suppress(FileExistsError):
            (maps / "street").symlink_to(street / "map")
        signed = {"signing_key": str(key)}
        settings = {
            "camera": {"kind": "stream", "device": device},
            "map": {"path": str(street / "map")},
            "mapping": {"folder": str(maps), "camera": {"kind": "stream", "device": device, "view": "rear"}},
            "recording": {"folder": str(tmp_path / "recordings")},
            "telemetry": {
                "connection": f"udpin:127.0.0.1:{free_port()}",
                "journal": str(tmp_path / "events.jsonl"),
                "drive": str(tmp_path / "newest.drive"),
                "signing_clock": str(tmp_path / "clock"),
                "links": [{"connection": "udp:127.0.0.1:9", **signed}],
                **signed,
            },
            "page": {"port": free_port(socket.SOCK_STREAM)},
        }
        path = tmp_path / "lookback.toml"
        path.write_text(tomli_w.dumps(settings).replace(replaced, by))
        return path

    return write_one


def search(texts: dict[str, str | bytes]) -> list[str]:
    """Where a secret stands, also in quotes of URLs or as it is in UTF-8."""
    return [
        f"{name} has {secret!r}: {re.search('.*' + re.escape(secret) + '.*', text)}"
        for name, content in texts.items()
        for text in [content if isinstance(content, str) else content.decode("utf-8", "replace")]
        for secret in SECRETS
        if secret in text
    ]


def written(folder: Path) -> dict[str, str | bytes]:
    """All files that may leave the vehicle; keys and configs are the secrets themselves."""
    files = [one for one in folder.rglob("*") if one.is_file() and one.suffix not in {".toml", ".key", ".zip"}]
    return {str(one.relative_to(folder)): one.read_bytes() for one in files}


def pages(port: int) -> dict[str, str | bytes]:
    """What the page says."""
    found: dict[str, str | bytes] = {}
    for path in ("", "status.json", "metrics", "healthz", "healthz/ready", "route.json", "register_service"):
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/{path}", timeout=30) as answer:
                found[path] = answer.read() + str(answer.headers).encode()
        except urllib.error.HTTPError as error:
            found[path] = error.read()
    return found


@pytest.mark.long
@pytest.mark.parametrize(
    "camera", [name for name in CAMERAS if name != "no such command"]
)  # with which it does not start
def test_the_daemon_says_no_secret(
    camera: str, write: Callable[..., Path], start: Callable[..., Any], tmp_path: Path
) -> None:
    config = write(camera)
    process = start(config, environment={"PYTHONUNBUFFERED": "1"})
    said: list[str] = []
    while "not recognized: camera: " not in process.told():
        said.append(process.wait_for_word(""))
    port = int(re.search(r"port = (\d+)", config.read_text()).group(1))  # type: ignore[union-attr]
    found = pages(port)
    said += [process.wait_for_word("") for _ in range(20)]
    assert process.end()[0] == 0, process.told()
    told = process.told()
    assert search({"log": told, "status": "\n".join(said), **found, **written(tmp_path)}) == []


@pytest.mark.long
@pytest.mark.parametrize("camera", CAMERAS)
def test_no_command_says_a_secret(
    camera: str, write: Callable[..., Path], street: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    config, bundle = write(camera), tmp_path / "it.zip"
    said: dict[str, str | bytes] = {}
    feed, of_map, to = str(street / "feed"), ["--map", str(street / "map")], ["-o", str(tmp_path / "made")]
    (tmp_path / "printed.log").write_text(f"{CAMERAS[camera]}\n")
    for words in (
        ["doctor", "--seconds", "0.2", str(config)],
        ["doctor", "--json", "--offline", str(config)],
        ["bundle", str(config), "-o", str(bundle), "--log", str(tmp_path / "printed.log")],
        ["record", str(config), *to, "--duration", "1"],
        ["replay", feed, *of_map, "--config", str(config)],
        ["eval", feed, *of_map, "--config", str(config)],
        ["calibrate", feed, *of_map, "--config", str(config)],
        ["map", "build", feed, "--config", str(config), "--no-keypoints", *to],
    ):
        status = main(words)
        out, err = capfd.readouterr()
        said[" ".join(words[:2])] = f"{status} {out}{err}"
    with zipfile.ZipFile(bundle) as files:
        said |= {f"bundle: {name}": files.read(name) for name in files.namelist()}
    (tmp_path / "printed.log").unlink()
    assert search(said | written(tmp_path)) == []


@pytest.mark.parametrize(
    ("replaced", "by"),
    [
        ('device = "rtsp:', 'device = "rtps:'),
        ('device = "rtsp:', 'device = "C:\\rtsp:'),
        ('kind = "stream"', 'kind = "streams"'),
        ('kind = "stream"', 'kind = "v4l2"'),
        ('kind = "stream"', 'kind = "feed"'),
        ('kind = "stream"', 'kind = "oak"'),
        (KEY.hex(), KEY.hex()),
    ],
)
@pytest.mark.parametrize("command", [["run"], ["doctor", "--offline"], ["record", "-o", os.devnull]])
def test_no_error_in_a_config_quotes_a_secret(
    replaced: str, by: str, command: list[str], write: Callable[..., Path], capfd: pytest.CaptureFixture[str]
) -> None:
    config = write("nobody answers", replaced, by)
    if replaced == KEY.hex():
        (config.parent / "mavlink.key").write_text(KEY.hex() + "9")
    status = main([*command, str(config)])
    assert status != 0 or "--offline" in command  # which looks at no device
    assert search({"said": "".join(capfd.readouterr())}) == []
