"""Streams from servers and commands that need nothing but Python and PyAV."""

from __future__ import annotations

import base64
import gc
import itertools
import os
import shlex
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import cv2
import numpy as np
import pytest

from edge.camera import Frame, open_camera
from edge.camera.newest import NewestFrame
from edge.config import CameraConfig
from edge.errors import CameraLost, ConfigError, FrameError
from edge_plugins.cameras import stream
from edge_plugins.cameras.command_output import CommandOutput
from edge_plugins.cameras.stream import BEHIND_NS, StreamCamera, StreamClock, open_source, size_difference
from tests.camera.conftest import index_of
from tests.common import PATIENCE_S

pytest.importorskip("av")
pytestmark = pytest.mark.usefixtures("busy")

PERIOD_S = 0.02
WIDTH, HEIGHT = 64, 48
WRITER = Path(__file__).with_name("write_stream.py")
MS = 1_000_000


def jpeg(index: int, width: int = WIDTH, height: int = HEIGHT) -> bytes:
    return cv2.imencode(".jpg", np.full((height, width, 3), 20 + 16 * (index % 13), np.uint8))[1].tobytes()


def part(data: bytes) -> bytes:
    return b"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n%s\r\n" % (len(data), data)


Script = Callable[[], Iterator[bytes]]
"""What one connection is sent, piece by piece; it is closed at the end."""


class MjpegServer:
    """MJPEG over HTTP from the standard library."""

    def __init__(self, script: Script, credentials: str = "") -> None:
        self.script, self.credentials = script, credentials
        self.stopping = threading.Event()
        outer = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                given = self.headers.get("Authorization", "").removeprefix("Basic ")
                if outer.credentials and base64.b64decode(given).decode() != outer.credentials:
                    self.send_response(401)
                    self.send_header("WWW-Authenticate", 'Basic realm="camera"')
                    self.end_headers()
                    return
                if self.path != "/video":
                    self.send_error(404)
                    return
                self.send_response(200)
                self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
                self.end_headers()
                try:
                    for piece in outer.script():
                        self.wfile.write(piece)
                        if outer.stopping.wait(PERIOD_S):
                            return
                except ConnectionError:
                    pass

            def log_message(self, *_: object) -> None:
                pass

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.port = self.server.server_address[1]
        self.thread = threading.Thread(target=self.server.serve_forever)
        self.thread.start()

    def config(self, user: str = "", **keys: float) -> CameraConfig:
        address = f"http://{user}127.0.0.1:{self.port}/video"
        keys = {"stall_timeout_s": PATIENCE_S, **keys}
        return CameraConfig(kind="stream", device=address, width=WIDTH, height=HEIGHT, **keys)  # type: ignore[arg-type]

    def close(self) -> None:
        self.stopping.set()
        self.server.shutdown()
        self.thread.join()
        self.server.server_close()


@pytest.fixture
def serve() -> Iterator[Callable[..., MjpegServer]]:
    servers: list[MjpegServer] = []

    def start(script: Script, credentials: str = "") -> MjpegServer:
        servers.append(MjpegServer(script, credentials))
        return servers[-1]

    yield start
    for server in servers:
        server.close()


def endless() -> Iterator[bytes]:
    return (part(jpeg(index)) for index in itertools.count())


def read_until(camera: StreamCamera, kind: type[Exception]) -> str:
    """Read until that error, and return its words."""
    with pytest.raises(kind) as raised:
        while True:
            camera.read()
    return str(raised.value)


def assert_is_a_camera(camera: StreamCamera, count: int = 5) -> list[Frame]:
    frames = [frame for frame in (camera.read() for _ in range(count)) if frame is not None]
    assert len(frames) == count
    assert {frame.image.shape for frame in frames} == {(HEIGHT, WIDTH, 3)}
    assert all(frame.image.dtype == np.uint8 and frame.image.flags.c_contiguous for frame in frames)
    assert all(np.diff([frame.stamp_ns for frame in frames]) > 0)
    assert all(np.diff([frame.index for frame in frames]) > 0)
    # In their order, and later images are not written into those that were handed on.
    shown = [index_of(frame.image) for frame in frames]
    assert all(step in (1, 1 - 13) for step in np.diff(shown))
    camera.close()
    camera.close()
    return frames


def test_mjpeg_over_http(serve: Callable[..., MjpegServer]) -> None:
    assert_is_a_camera(StreamCamera(serve(endless).config()))


@pytest.mark.parametrize(
    ("name", "codec"),
    [("mjpeg", "mjpeg"), ("h264", "libx264"), ("mpegts", "libx264"), ("matroska", "mjpeg"), ("nut", "libx264")],
)
def test_the_output_of_a_command(name: str, codec: str) -> None:
    command = shlex.join([sys.executable, str(WRITER), name, codec, "100000"])
    config = CameraConfig(
        kind="stream", device=f"exec:{command}", width=WIDTH, height=HEIGHT, stall_timeout_s=PATIENCE_S
    )
    assert_is_a_camera(StreamCamera(config, PATIENCE_S))


def test_images_are_scaled_to_the_configured_size(serve: Callable[..., MjpegServer]) -> None:
    server = serve(lambda: (part(jpeg(index, 128, 72)) for index in itertools.count()))
    camera = StreamCamera(server.config())
    assert camera.differences == ("size: asked for 64 x 48, the stream is 128 x 72, so its images are squeezed",)
    assert_is_a_camera(camera)
    assert size_difference((1280, 960), (640, 480)) == ()


def test_only_the_newest_frame_is_kept(serve: Callable[..., MjpegServer]) -> None:
    many = threading.Event()

    def script() -> Iterator[bytes]:
        for index in itertools.count():
            if index == 100:
                many.set()
            yield part(jpeg(index))

    newest = NewestFrame.configured(serve(script).config())
    assert many.wait(PATIENCE_S)
    delivered = newest.health.delivered
    frame = newest.take(PATIENCE_S)
    assert frame is not None
    assert delivered > 20
    assert frame.index >= delivered - 1, "not one of those that came before"
    newest.close()


def test_a_server_that_went_away_is_connected_to_again(serve: Callable[..., MjpegServer]) -> None:
    connections = itertools.count()

    def script() -> Iterator[bytes]:
        frames = 80 if next(connections) == 0 else 10**9
        return (part(jpeg(index)) for index in range(frames))

    server = serve(script)
    newest = NewestFrame(lambda: open_camera(server.config()), first_back_off_s=0.01)
    indices: list[int] = []
    while newest.health.reopened == 0:
        frame = newest.take(PATIENCE_S)
        assert frame is not None
        indices.append(frame.index)
    frame = newest.take(PATIENCE_S)
    assert frame is not None
    assert all(np.diff([*indices, frame.index]) > 0)
    assert next(connections) >= 2
    newest.close()


def test_the_end_of_a_stream_is_a_lost_camera(serve: Callable[..., MjpegServer]) -> None:
    camera = StreamCamera(serve(lambda: itertools.islice(endless(), 60)).config())
    assert read_until(camera, CameraLost).endswith("/video: the stream ended")
    camera.close()


def test_garbage_is_no_video(serve: Callable[..., MjpegServer]) -> None:
    noise = np.random.default_rng(5).bytes(50_000)
    with pytest.raises(CameraLost, match="this is no video that can be decoded here"):
        StreamCamera(serve(lambda: itertools.repeat(noise)).config())


@pytest.mark.parametrize("damage", ["garbage", "half a frame"])
def test_a_damaged_image_is_one_bad_frame(damage: str, serve: Callable[..., MjpegServer]) -> None:
    whole = cv2.imencode(".jpg", np.random.default_rng(7).integers(0, 255, (HEIGHT, WIDTH, 3), np.uint8))[1].tobytes()
    bad = whole[: len(whole) // 2] if damage == "half a frame" else b"\xff\xd8" + np.random.default_rng(9).bytes(2000)
    server = serve(lambda: (part(bad if index % 50 == 49 else jpeg(index)) for index in itertools.count()))
    camera = StreamCamera(server.config())
    assert read_until(camera, FrameError).endswith(
        "an image cannot be decoded: Invalid data found when processing input"
    )
    assert_is_a_camera(camera)


def test_another_size_midway_opens_the_stream_again(serve: Callable[..., MjpegServer]) -> None:
    server = serve(lambda: (part(jpeg(index, WIDTH if index < 60 else 2 * WIDTH)) for index in itertools.count()))
    camera = StreamCamera(server.config())
    assert read_until(camera, CameraLost).endswith("its images changed from 64 x 48 to 128 x 48 pixels; opened again")
    camera.close()


def test_wrong_credentials_are_said_without_repeating_them(serve: Callable[..., MjpegServer]) -> None:
    server = serve(endless, "pilot:correct")
    with pytest.raises(CameraLost, match=r"http://127.*: wrong user name or password \(401\)") as raised:
        StreamCamera(server.config("pilot:secret@"))
    assert "secret" not in str(raised.value)
    assert_is_a_camera(StreamCamera(server.config("pilot:correct@")))


def test_a_stream_that_hangs_is_lost_in_time(serve: Callable[..., MjpegServer]) -> None:
    let_go = threading.Event()

    def script() -> Iterator[bytes]:
        yield from itertools.islice(endless(), 60)
        let_go.wait(PATIENCE_S)

    camera = StreamCamera(serve(script).config(stall_timeout_s=1.0))  # a busy computer opens it as well
    assert read_until(camera, CameraLost).endswith("no answer; is the camera on, and the network up?")
    let_go.set()
    camera.close()


@pytest.mark.parametrize("scheme", ["rtsp", "http", "tcp"])
def test_a_server_that_says_nothing_is_given_up(scheme: str) -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        device = f"{scheme}://127.0.0.1:{silent.getsockname()[1]}/"
        with pytest.raises(CameraLost, match="no answer; is the camera on"):
            StreamCamera(CameraConfig(kind="stream", device=device), open_timeout_s=0.3)


def test_what_is_wrong_with_a_server_is_said_in_one_line(serve: Callable[..., MjpegServer], tmp_path: Path) -> None:
    port = serve(endless).port
    with socket.create_server(("127.0.0.1", 0)) as closed:
        closed_port = closed.getsockname()[1]
    for device, why in {
        f"http://127.0.0.1:{closed_port}/": "connection refused",
        f"rtsp://user:secret@127.0.0.1:{closed_port}/": "connection refused",
        f"http://127.0.0.1:{port}/other?password=secret": r"there is no such stream \(404\)",
        f"unix:{tmp_path}/none": "there is no such socket",
    }.items():
        with pytest.raises(CameraLost, match=why) as raised:
            StreamCamera(CameraConfig(kind="stream", device=device))
        assert "secret" not in str(raised.value)


def test_images_that_come_faster_than_they_are_decoded_are_not_used_late(
    serve: Callable[..., MjpegServer], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stream, "BEHIND_NS", BEHIND_NS)
    noise = np.random.default_rng(11).integers(0, 255, (480, 640, 3), np.uint8)  # slow to decode
    piece = part(cv2.imencode(".jpg", noise)[1].tobytes()) * 20
    config = serve(lambda: itertools.repeat(piece)).config()
    why = "images come faster than they are decoded here"
    with pytest.raises(CameraLost, match=why), closing(StreamCamera(config)) as camera:
        while True:
            camera.read()


@pytest.mark.parametrize(
    ("command", "why"),
    [
        (
            "sh -c 'echo first >&2; echo no cameras available >&2; exit 3'",
            "sh: exited with status 3: no cameras available",
        ),
        ("true", "true: exited with status 0"),
        ("sh -c 'echo rtsp://user:secret@cam/: refused >&2; exit 1'", "sh: exited with status 1: rtsp://cam/: refused"),
        ("sh -c 'kill -9 $$'", "sh: was ended by SIGKILL"),
        ("yes", "yes: this is no video that can be decoded here"),
        ("sh -c 'echo waiting for the sensor >&2; exec sleep 60'", "sh: gave no image in time: waiting for the sensor"),
    ],
)
def test_what_is_wrong_with_a_command_is_said_in_its_own_words(command: str, why: str) -> None:
    with pytest.raises(CameraLost) as raised:
        StreamCamera(CameraConfig(kind="stream", device=f"exec:{command}"), open_timeout_s=1.0)
    assert str(raised.value) == why


@pytest.mark.parametrize("form", ["mpegts", "mjpeg"])
def test_a_command_that_hangs_is_one_line(form: str, capfd: pytest.CaptureFixture[str]) -> None:
    """PyAV printed a traceback for each further read."""
    codec = "mjpeg" if form == "mjpeg" else "mpeg4"
    command = f"exec:sh -c '{sys.executable} {WRITER} {form} {codec} 20; exec sleep 60'"
    config = CameraConfig(kind="stream", device=command, stall_timeout_s=0.5)
    with pytest.raises(CameraLost, match=r"^sh: gave no image in time$"), closing(StreamCamera(config, 5.0)) as camera:
        while True:
            camera.read()
    gc.collect()
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    ("device", "why"),
    [
        ("exec:no-such-program -o -", "cannot start no-such-program: no such program"),
        ("exec:'", "exec: no closing quotation"),
        ("exec:", "expected an address or a command that begins with rtsp, "),
        ("file:///etc/passwd", "expected an address or a command that begins with rtsp, "),
        ("rtsp://", "expected an address or a command that begins with rtsp, "),
    ],
)
def test_a_device_that_cannot_be_right_is_a_wrong_config(device: str, why: str) -> None:
    with pytest.raises(ConfigError) as raised:
        open_source(device)
    assert str(raised.value).startswith(f"[camera] device: {why}")


def test_a_command_is_ended_with_the_camera_although_its_thread_blocks_signals(tmp_path: Path) -> None:
    script = (
        f"trap 'echo ended > {tmp_path}/trace; exit' TERM; echo $$ > {tmp_path}/pid; echo ready;"
        " while :; do sleep 0.05; done"
    )

    def run() -> None:
        signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
        output = CommandOutput(["sh", "-c", script])
        output.expires_ns = time.monotonic_ns() + round(PATIENCE_S * 1e9)
        assert output.read(100) == b"ready\n"
        output.close()
        output.close()

    thread = threading.Thread(target=run)
    thread.start()
    thread.join(PATIENCE_S)
    assert (tmp_path / "trace").read_text() == "ended\n"
    with pytest.raises(ProcessLookupError):
        os.kill(int((tmp_path / "pid").read_text()), 0)


def is_running(pid: int) -> bool:
    """Not a zombie that nobody waits for, as of a container without an init."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):  # gone before it is opened, or read
        return False


def ends(pid: int) -> bool:
    """Whether a process ends soon."""
    until_s = time.monotonic() + PATIENCE_S
    while is_running(pid) and time.monotonic() < until_s:
        time.sleep(0.01)
    return not is_running(pid)


@pytest.mark.parametrize("trap", ["", "trap '' TERM; "])
def test_a_command_that_gives_nothing_is_ended_by_the_thread_that_closes(tmp_path: Path, trap: str) -> None:
    """With an opening that waits for 60 s, and also where the command ignores SIGTERM."""
    script = f"{trap}echo $$ > {tmp_path}/pid; mv {tmp_path}/pid {tmp_path}/started; while :; do sleep 0.1; done"
    config = CameraConfig(kind="stream", device=f"exec:{shlex.join(['sh', '-c', script])}")
    newest = NewestFrame(lambda: StreamCamera(config, 60.0), start_s=0.0)
    until_s = time.monotonic() + PATIENCE_S
    while not (tmp_path / "started").exists() and time.monotonic() < until_s:
        time.sleep(0.01)
    pid = int((tmp_path / "started").read_text())
    assert is_running(pid)
    newest.close()
    assert ends(pid)


def test_a_command_ends_with_a_process_that_is_killed() -> None:
    """Once it has started: what is killed before setpriv has asked for the signal leaves its command running."""
    program = (
        "import os, time\nfrom edge_plugins.cameras.command_output import CommandOutput\n"
        "command = CommandOutput(['sh', '-c', 'echo started; exec sleep 3600'])\n"
        f"command.expires_ns = time.monotonic_ns() + {PATIENCE_S} * 10**9\nassert command.read(99) == b'started\\n'\n"
        "print(command._process.pid, flush=True)\nos.kill(os.getpid(), 9)"
    )
    result = subprocess.run([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True, check=False)
    assert result.returncode == -9
    assert ends(int(result.stdout))


def test_without_pyav_the_extra_is_named() -> None:
    program = (
        "import sys; sys.modules['av'] = None\n"
        "from edge.camera import open_camera; from edge.config import CameraConfig\n"
        "open_camera(CameraConfig(kind='stream', device='rtsp://camera/'))"
    )
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert "[camera] kind: stream needs PyAV: " in result.stderr.splitlines()[-1]


def test_a_stream_time_is_that_of_the_smallest_delay() -> None:
    clock = StreamClock()
    # Three images 100 ms apart; the network holds the first back by 40 ms and the last by 500 ms.
    clock.arrived(1_000 * MS, 50_040 * MS)
    clock.arrived(1_100 * MS, 50_100 * MS)
    clock.arrived(1_200 * MS, 50_700 * MS)
    assert clock.monotonic_ns(1_100 * MS) == pytest.approx(50_100 * MS, abs=7 * MS)
    assert clock.monotonic_ns(1_200 * MS) == pytest.approx(50_200 * MS, abs=7 * MS)


@pytest.mark.parametrize("rate", [0.995, 0.9999, 1.0, 1.0001, 1.05])
def test_a_clock_that_runs_slow_or_fast_is_followed(rate: float) -> None:
    clock = StreamClock()
    for image in range(10_000):
        arrived_ns = 1_000_000 * MS + image * 50 * MS
        clock.arrived(round(image * 50 * MS * rate), arrived_ns)
        assert clock.monotonic_ns(round(image * 50 * MS * rate)) == pytest.approx(arrived_ns, abs=MS)


def test_the_latency_is_subtracted(serve: Callable[..., MjpegServer]) -> None:
    def early_ns(latency_s: float) -> int:
        """How long before it was read the first image was exposed, at least."""
        camera = StreamCamera(serve(endless).config(latency_s=latency_s))
        frame = camera.read()
        now_ns = time.monotonic_ns()
        camera.close()
        assert frame is not None
        return now_ns - frame.stamp_ns

    assert early_ns(4.5) > 4_500 * MS
    assert 0 < early_ns(0.0) < 4_500 * MS
