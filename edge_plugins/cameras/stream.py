"""A video stream: RTSP, HTTP, a socket, or the standard output of a command, through PyAV (extra `stream`).

[camera] device is the stream's address, or `exec:` and a command. Images are scaled to the configured size.
"""

from __future__ import annotations

import errno
import shlex
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, TypeAlias, cast

import numpy as np

from edge.config import CameraConfig
from edge.errors import CameraLost, ConfigError, FrameError
from edge.extras import import_extra
from edge.feed import Frame
from edge_plugins.cameras.command_output import CommandOutput

FORGETTING = 0.01
"""The smallest delay grows by this share of the time since it was seen, so that a clock that runs slow is followed."""


class StreamClock:
    """Takes the smallest delay between a stream's time and the arrival as the transport's; what is more is waiting.

    A picture's exposure is then its stream time plus that delay, however long the network held it back.
    """

    def __init__(self) -> None:
        self._delay_ns = 0.0
        self._arrived_ns: int | None = None

    def arrived(self, stream_ns: int, arrived_ns: int) -> None:
        """Learn from one packet: its time in the stream, and when it arrived on CLOCK_MONOTONIC."""
        delay_ns = float(arrived_ns - stream_ns)
        if self._arrived_ns is not None:
            delay_ns = min(delay_ns, self._delay_ns + FORGETTING * (arrived_ns - self._arrived_ns))
        self._delay_ns, self._arrived_ns = delay_ns, arrived_ns

    def monotonic_ns(self, stream_ns: int) -> int:
        """A stream time on CLOCK_MONOTONIC; only after the first packet has arrived."""
        return stream_ns + round(self._delay_ns)


if TYPE_CHECKING:
    import av
    import av.container
    import av.error
    import av.video.stream

    Packets: TypeAlias = Iterator[av.Packet[av.video.stream.VideoStream]]

SCHEMES = ("rtsp", "rtsps", "http", "https", "tcp", "udp", "unix", "exec")
PROTOCOLS = "rtsp,rtp,srtp,udp,tcp,tls,http,httpproxy,https,unix"
"""What FFmpeg may open for a stream: no playlist of a foreign server makes it read a file of this computer."""
WITH_CLOCK = ("rtsp", "mpegts", "matroska", "mov", "flv", "nut")
"""Formats whose time stamps come from a clock. Other formats have none, and FFmpeg then counts frames."""
FOUND_BY_NEXT = ("mjpeg", "jpeg_pipe", "h264", "hevc")
"""Formats without lengths: FFmpeg hands an image over when it reads the start of the next one."""
WITHOUT_CLOCK = (*FOUND_BY_NEXT, "mpjpeg", "yuv4mpegpipe")
OPTIONS = {
    "protocol_whitelist": PROTOCOLS,
    "format_whitelist": ",".join((*WITH_CLOCK, "matroska,webm", "mov,mp4,m4a,3gp,3g2,mj2", *WITHOUT_CLOCK)),
    # Microseconds, and bytes: by default FFmpeg reads up to 5 s and 5 MB before the first image.
    "analyzeduration": "1000000",
    "probesize": "500000",
    "formatprobesize": "65536",
    "fpsprobesize": "0",  # nor the 20 images from which it finds out how many come in a second
    "rtsp_flags": "prefer_tcp",
    "allowed_media_types": "video",
}
CODEC_OPTIONS = {"threads": "1", "flags": "low_delay"}  # more threads would each delay by an image
OPEN_S = 6.0
FIRST_FRAME_S = 10.0
"""An encoder may send a key frame only every few seconds."""
SETTLE_S = 0.5
"""What was buffered while the stream was opened is old, and comes without waiting: not used."""
WAITED_NS = 1_000_000
BEHIND_NS = 2_000_000_000
LEAST_WAITING = 0.1
"""Share of the time in which a camera that is not too fast is waited for."""
REASONS: dict[str | int | None, str] = {
    "HTTPUnauthorizedError": "wrong user name or password (401); write rtsp://USER:PASSWORD@HOST/PATH",
    "HTTPForbiddenError": "access denied (403)",
    "HTTPNotFoundError": "there is no such stream (404); is the path right?",
    "HTTPServerError": "the server reports an error (5xx)",
    "InvalidDataError": "this is no video that can be decoded here",
    "ExitError": "no answer; is the camera on, and the network up?",
    errno.ETIMEDOUT: "no answer; is the camera on, and the network up?",
    errno.ECONNREFUSED: "connection refused; is the camera's server running?",
    errno.EIO: "it cannot be reached, or sends nothing; is the name of the host right?",
    errno.ENOENT: "there is no such socket; is the service that makes it running?",
    errno.EACCES: "no permission",
    errno.EINVAL: "this is no video format that is accepted here; see docs/cameras.md",
}
"""By the name of PyAV's class for FFmpeg's own errors, or by the system's number."""


class StreamCamera:
    """Decodes a stream as fast as it comes; each image has the stream's own time, or else the time it arrived."""

    def __init__(self, config: CameraConfig, open_timeout_s: float = OPEN_S) -> None:
        """Connect, or start the command, and wait for the first image that is not old.

        open_timeout_s: FFmpeg takes it twice at most, to connect and to find out what is in the stream.
        Raises ConfigError for an address or a program that cannot be right, and CameraLost for all that may pass.
        """
        self._av = import_extra("av", "stream", "[camera] kind: stream needs PyAV")
        self._config, self._name = config, config.source.removeprefix("stream ").removeprefix("exec:")
        self.read_timeout_s = config.stall_timeout_s
        self._clock, self._arrived_ns, self._index = StreamClock(), 0, 0
        self._container: av.container.InputContainer | None = None
        self._size: tuple[int, int] | None = None
        self._source = open_source(config.device)
        try:
            self._open(open_timeout_s)
            self._first: Frame | None = self._read_first()
            self.differences = size_difference(self._size or (0, 0), (config.width, config.height))
        except BaseException:
            self.close()
            raise

    def _open(self, timeout_s: float) -> None:
        timeouts = timeout_s, self._config.stall_timeout_s
        expires_ns = time.monotonic_ns() + round(timeout_s * 1e9)
        if isinstance(self._source, CommandOutput):
            self._source.expires_ns = expires_ns
        try:
            self._container = self._av.open(self._source, "r", options=OPTIONS, timeout=timeouts)
        except self._av.error.FFmpegError as error:
            raise self._lost(error, time.monotonic_ns() >= expires_ns) from None
        format_name = self._container.format.name.partition(",")[0]
        self._has_clock, self._found_by_next = format_name in WITH_CLOCK, format_name in FOUND_BY_NEXT
        if not self._container.streams.video:
            raise CameraLost(f"{self._name}: there is no video in this stream")
        self._video = self._container.streams.video[0]
        codec = self._video.codec_context
        if codec is None:
            raise CameraLost(f"{self._name}: its codec is unknown; use H.264, H.265 or MJPEG")
        # A JPEG that is cut short would otherwise be gray from there on. H.264 repairs itself, and says so.
        codec.options = {**CODEC_OPTIONS, **({"err_detect": "explode"} if codec.name == "mjpeg" else {})}
        self._packets = cast("Packets", self._container.demux())

    def _read_first(self) -> Frame:
        self._waited_ns, self._counted_since_ns = 0, time.monotonic_ns()
        settled_ns = self._counted_since_ns + round(SETTLE_S * 1e9)
        deadline_ns = settled_ns + round(FIRST_FRAME_S * 1e9)
        while True:
            try:
                frame = self._next(deadline_ns)
            except FrameError:
                continue
            if self._last_wait_ns >= WAITED_NS and time.monotonic_ns() >= settled_ns:
                return frame

    def read(self) -> Frame | None:
        """Block until the next image, at most `stall_timeout_s`; never None."""
        first, self._first = self._first, None
        return first or self._next(time.monotonic_ns() + round(self._config.stall_timeout_s * 1e9))

    def _next(self, deadline_ns: int) -> Frame:
        """Decode the next image. CameraLost if there is none before the deadline, FrameError for a damaged one."""
        while time.monotonic_ns() < deadline_ns:
            packet, before_ns = self._receive()
            if packet.stream.index != self._video.index:
                continue
            try:
                decoded = packet.decode()
            except self._av.error.FFmpegError as error:
                raise FrameError(f"{self._name}: an image cannot be decoded: {error.strerror}") from None
            if decoded:
                return self._as_frame(decoded[-1], before_ns if self._found_by_next else self._arrived_ns)
        raise CameraLost(f"{self._name}: it sends data, and no image that can be decoded")

    def _receive(self) -> tuple[av.Packet[av.video.stream.VideoStream], int]:
        """The next packet, and when the one before it arrived."""
        asked_ns, before_ns = time.monotonic_ns(), self._arrived_ns
        expires_ns = asked_ns + round(self._config.stall_timeout_s * 1e9)
        if isinstance(self._source, CommandOutput):
            self._source.expires_ns = expires_ns
        try:
            packet = next(self._packets, None)
        except self._av.error.FFmpegError as error:
            raise self._lost(error, time.monotonic_ns() >= expires_ns) from None
        now_ns = self._arrived_ns = time.monotonic_ns()
        # At the end, PyAV flushes the decoder; after an interruption, FFmpeg hands over what it has of a packet.
        if packet is None or packet.size == 0 or now_ns >= expires_ns:
            raise self._lost(None, now_ns >= expires_ns)
        self._count_wait(asked_ns, now_ns)
        if self._has_clock and packet.pts is not None and packet.time_base is not None:
            self._clock.arrived(round(packet.pts * packet.time_base * 1_000_000_000), now_ns)
        return packet, before_ns or now_ns

    def _count_wait(self, asked_ns: int, now_ns: int) -> None:
        """CameraLost if packets hardly had to be waited for: older ones then lie in buffers, and more each second."""
        self._last_wait_ns = now_ns - asked_ns
        self._waited_ns += self._last_wait_ns
        if now_ns - self._counted_since_ns < BEHIND_NS:
            return
        if self._waited_ns < LEAST_WAITING * (now_ns - self._counted_since_ns):
            raise CameraLost(f"{self._name}: images come faster than they are decoded here; lower their size or rate")
        self._waited_ns, self._counted_since_ns = 0, now_ns

    def _as_frame(self, picture: av.VideoFrame, arrived_ns: int) -> Frame:
        size = picture.width, picture.height
        self._size = self._size or size
        if size != self._size:
            was, now = _pixels(self._size), _pixels(size)
            raise CameraLost(f"{self._name}: its images changed from {was} to {now} pixels; opened again")
        if picture.is_corrupt:
            raise FrameError(f"{self._name}: an image is damaged; was data lost on the way?")
        image = picture.to_ndarray(
            format="bgr24", width=self._config.width, height=self._config.height, interpolation="AREA"
        )
        stamp_ns = arrived_ns
        if self._has_clock and picture.pts is not None and picture.time_base is not None:
            stamp_ns = self._clock.monotonic_ns(round(picture.pts * picture.time_base * 1_000_000_000))
        if arrived_ns - stamp_ns > BEHIND_NS:
            raise CameraLost(f"{self._name}: its images come {(arrived_ns - stamp_ns) / 1e9:.1f} s late; opened again")
        index, self._index = self._index, self._index + 1
        latency_ns = round(self._config.latency_s * 1e9)
        return Frame(np.ascontiguousarray(image, dtype=np.uint8), stamp_ns - latency_ns, index)

    def _lost(self, error: av.error.FFmpegError | None, timed_out: bool) -> CameraLost:
        """What is wrong, in one line without the address's password."""
        if isinstance(self._source, CommandOutput) and (self._source.ended or self._source.expired):
            return CameraLost(self._source.why_ended())
        if timed_out:
            why = REASONS[errno.ETIMEDOUT]
        elif error is None or (error.errno == errno.EIO and self._container is not None):
            why = "the stream ended"
        else:
            name = type(error).__name__
            why = REASONS.get(name) or REASONS.get(error.errno) or error.strerror or name
        return CameraLost(f"{self._name}: {why}")

    def close(self) -> None:
        """Disconnect, or end the command; more than once is harmless."""
        if isinstance(self._source, CommandOutput):
            self._source.close()
        if self._container is not None:
            self._container.close()


def open_source(device: str) -> str | CommandOutput:
    """The address for FFmpeg, or the running command. ConfigError for neither."""
    scheme, _, rest = device.partition(":")
    if scheme not in SCHEMES or not rest.strip("/ "):
        raise ConfigError(f"[camera] device: expected an address or a command that begins with {', '.join(SCHEMES)}:")
    if scheme != "exec":
        return device
    try:
        return CommandOutput(shlex.split(rest))
    except ValueError as error:
        raise ConfigError(f"[camera] device: exec: {str(error).lower()}") from None


def size_difference(given: tuple[int, int], asked: tuple[int, int]) -> tuple[str, ...]:
    """A line if scaling changes the proportions of the images, which matters between two cameras of one map."""
    if given[0] * asked[1] == given[1] * asked[0]:
        return ()
    return (f"size: asked for {_pixels(asked)}, the stream is {_pixels(given)}, so its images are squeezed",)


def _pixels(size: tuple[int, int]) -> str:
    return f"{size[0]} x {size[1]}"
