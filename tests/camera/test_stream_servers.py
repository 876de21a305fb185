"""Streams from the programs that vehicles use: GStreamer, FFmpeg, and a socket of systemd. Skipped without them."""

from __future__ import annotations

import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from edge.camera import open_camera
from edge.camera.newest import NewestFrame
from edge.config import CameraConfig
from edge.errors import CameraLost
from edge_plugins.cameras.stream import StreamCamera
from tests.common import PATIENCE_S

pytest.importorskip("av")
pytestmark = pytest.mark.usefixtures("busy")

HERE = Path(__file__).parent
SYSTEM_PYTHON = "/usr/bin/python3"
TEST_IMAGES = "videotestsrc is-live=true ! video/x-raw,format=I420,width=320,height=240,framerate=25/1"
H264 = f"( {TEST_IMAGES} ! x264enc tune=zerolatency key-int-max=10 ! rtph264pay name=pay0 pt=96 )"
MJPEG = f"( {TEST_IMAGES} ! jpegenc ! rtpjpegpay name=pay0 )"
Start = Callable[..., "subprocess.Popen[str]"]


def need(program: str) -> str:
    found = shutil.which(program)
    if found is None:
        pytest.skip(f"needs {program}, which is not installed")
    return found


def config(device: str, **keys: float) -> CameraConfig:
    keys = {"stall_timeout_s": PATIENCE_S, **keys}
    return CameraConfig(kind="stream", device=device, width=320, height=240, **keys)  # type: ignore[arg-type]


def assert_gives_frames(camera: StreamCamera, count: int = 20) -> None:
    frames = [frame for frame in (camera.read() for _ in range(count)) if frame is not None]
    assert {frame.image.shape for frame in frames} == {(240, 320, 3)}
    assert float(frames[0].image.std()) > 40, "color bars"
    assert all(np.diff([frame.stamp_ns for frame in frames]) > 0)
    camera.close()


@pytest.fixture
def start() -> Iterator[Start]:
    running: list[subprocess.Popen[str]] = []

    def run(*words: str, **keys: int) -> subprocess.Popen[str]:
        running.append(subprocess.Popen(words, text=True, **keys))  # type: ignore[call-overload]
        return running[-1]

    yield run
    for process in running:
        process.send_signal(signal.SIGCONT)
        process.kill()
        process.communicate()


@pytest.fixture
def rtsp(start: Start) -> Callable[..., tuple[subprocess.Popen[str], str]]:
    """Starts the RTSP server; returns it and the address without `rtsp://`."""
    probe = "import gi; gi.require_version('GstRtspServer', '1.0')"
    if not Path(SYSTEM_PYTHON).exists() or subprocess.run([SYSTEM_PYTHON, "-c", probe], check=False).returncode:
        pytest.skip("needs Debian's gir1.2-gst-rtsp-server-1.0 and python3-gi, which are not installed")

    def run(*words: str) -> tuple[subprocess.Popen[str], str]:
        process = start(SYSTEM_PYTHON, str(HERE / "rtsp_server.py"), *words, stdout=subprocess.PIPE)
        assert process.stdout is not None
        return process, f"127.0.0.1:{int(process.stdout.readline())}/camera"

    return run


@pytest.mark.parametrize("launch", [H264, MJPEG], ids=["h264", "mjpeg"])
def test_rtsp(launch: str, rtsp: Callable[..., tuple[object, str]]) -> None:
    _, address = rtsp(launch)
    assert_gives_frames(StreamCamera(config(f"rtsp://{address}")))
    with pytest.raises(CameraLost, match=r"/camera/none: there is no such stream \(404\)"):
        StreamCamera(config(f"rtsp://{address}/none"))


def test_rtsp_with_a_password(rtsp: Callable[..., tuple[object, str]]) -> None:
    _, address = rtsp(H264, "pilot:correct")
    with pytest.raises(CameraLost, match=r"wrong user name or password \(401\)"):
        StreamCamera(config(f"rtsp://pilot:wrong@{address}"))
    assert_gives_frames(StreamCamera(config(f"rtsp://pilot:correct@{address}")))


def test_an_rtsp_server_that_hangs_or_dies_is_a_lost_camera(
    rtsp: Callable[..., tuple[subprocess.Popen[str], str]],
) -> None:
    process, address = rtsp(H264)
    camera = StreamCamera(config(f"rtsp://{address}", stall_timeout_s=0.5))
    process.send_signal(signal.SIGSTOP)
    with pytest.raises(CameraLost, match="no answer"):
        while True:
            camera.read()
    camera.close()
    process.send_signal(signal.SIGCONT)
    newest = NewestFrame(lambda: open_camera(config(f"rtsp://{address}")), first_back_off_s=0.01)
    assert newest.take(PATIENCE_S) is not None
    process.kill()
    while newest.health.state != "lost":
        newest.take(0.01)
    assert newest.health.reason
    newest.close()


def test_mjpeg_over_http_from_ffmpeg(start: Start) -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        address = f"http://127.0.0.1:{free.getsockname()[1]}/video"
    source = ["-re", "-f", "lavfi", "-i", "testsrc=size=320x240:rate=25", "-c:v", "mjpeg", "-f", "mpjpeg"]
    serving = start(need("ffmpeg"), "-loglevel", "error", *source, "-listen", "1", address)
    newest = NewestFrame(lambda: open_camera(config(address)), first_back_off_s=0.05)  # until it listens
    frame = newest.take(PATIENCE_S)
    assert frame is not None, newest.health.reason
    assert frame.image.shape == (240, 320, 3)
    serving.kill()
    newest.close()


FFMPEG = "ffmpeg -loglevel error -re -f lavfi -i testsrc=size=320x240:rate=25 -pix_fmt yuv420p"
COMMANDS = {
    "ffmpeg h264": f"{FFMPEG} -c:v libx264 -preset ultrafast -tune zerolatency -f h264 -",
    "ffmpeg mpegts": f"{FFMPEG} -c:v libx264 -preset ultrafast -tune zerolatency -f mpegts -",
    "ffmpeg mjpeg": f"{FFMPEG} -c:v mjpeg -f mjpeg -",
    "ffmpeg y4m": f"{FFMPEG} -f yuv4mpegpipe -",
    "gstreamer mjpeg": f"gst-launch-1.0 -q {TEST_IMAGES} ! jpegenc ! fdsink",
    "gstreamer y4m": f"gst-launch-1.0 -q {TEST_IMAGES} ! y4menc ! fdsink",
    "gstreamer matroska": f"gst-launch-1.0 -q {TEST_IMAGES} ! jpegenc ! matroskamux streamable=true ! fdsink",
}


@pytest.mark.parametrize("name", COMMANDS)
def test_the_output_of_a_command(name: str) -> None:
    need(COMMANDS[name].split()[0])
    assert_gives_frames(StreamCamera(config(f"exec:{COMMANDS[name]}")))


@pytest.mark.parametrize(
    ("command", "why"),
    [
        ("gst-launch-1.0 -q nosuchsource ! fdsink", 'exited with status 1: WARNING: erroneous pipeline: no element "'),
        ("ffmpeg -loglevel error -i /none -f mjpeg -", "exited with status 1: /none: No such file or directory"),
        ("ffmpeg -loglevel error -re -f lavfi -i sine -f mpegts -", "there is no video in this stream"),
        ("ffmpeg -loglevel error -re -f lavfi -i sine -f wav -", "this is no video format that is accepted here"),
    ],
)
def test_what_is_wrong_with_a_command_is_said_in_its_own_words(command: str, why: str) -> None:
    need(program := command.split(maxsplit=1)[0])
    with pytest.raises(CameraLost) as raised:
        StreamCamera(config(f"exec:{command}"))
    assert str(raised.value).startswith(f"{program}: {why}")


def test_a_socket_that_systemd_listens_on_starts_the_command_for_each_connection(start: Start, tmp_path: Path) -> None:
    """As systemd/lookback-camera.socket does, with systemd's own program for it."""
    listen, address = need("systemd-socket-activate"), tmp_path / "camera"
    writer = [sys.executable, str(HERE / "write_stream.py"), "mjpeg", "mjpeg", "100000"]
    start(listen, "--accept", "--inetd", "--listen", str(address), *writer, stderr=subprocess.DEVNULL)
    newest = NewestFrame(lambda: open_camera(config(f"unix:{address}")), first_back_off_s=0.05)  # until it listens
    assert newest.take(PATIENCE_S) is not None, newest.health.reason
    newest.reopen("to connect again")
    while newest.health.reopened == 0:
        newest.take(0.01)
    assert newest.take(PATIENCE_S) is not None
    newest.close()
