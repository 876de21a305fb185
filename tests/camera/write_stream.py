"""A command for tests: encodes images of known brightness with PyAV and writes them to standard output.

Usage: write_stream.py FORMAT CODEC FRAMES [WIDTH]; the image of index i is as bright as `brightness(i)`.
"""

from __future__ import annotations

import sys
import threading
import time
from fractions import Fraction
from typing import Any

import av
import numpy as np

FPS = 25
HEIGHT = 48


def main() -> None:
    name, codec, count = sys.argv[1], sys.argv[2], int(sys.argv[3])
    width = int(sys.argv[4]) if len(sys.argv) > 4 else 64
    pace, began_s = threading.Event(), time.monotonic()
    with av.open(sys.stdout.buffer, "w", format=name, options={"flush_packets": "1"}) as output:
        fast = {"preset": "ultrafast", "tune": "zerolatency"} if codec == "libx264" else {}
        stream: Any = output.add_stream(codec, rate=FPS, options=fast)
        stream.width, stream.height = width, HEIGHT
        stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
        stream.codec_context.time_base = Fraction(1, FPS)
        stream.codec_context.gop_size = 5
        for index in range(count):
            level = 20 + 16 * (index % 13)
            picture = av.VideoFrame.from_ndarray(np.full((HEIGHT, width, 3), level, np.uint8), format="rgb24")
            picture.pts = index
            for packet in stream.encode(picture):
                output.mux(packet)
            sys.stdout.buffer.flush()
            pace.wait(max(0.0, began_s + (index + 1) / FPS - time.monotonic()))


if __name__ == "__main__":
    main()
