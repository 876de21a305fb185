"""What threads of `edge.files.BackgroundWorker` still write, and a disk that is full."""

from __future__ import annotations

import resource
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def full_disk(size_bytes: int = 0) -> Iterator[None]:
    """The largest file allowed stands in for it: writes beyond that fail in the same way, after some bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE), signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size_bytes, before[0][1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before[0])
        signal.signal(signal.SIGXFSZ, before[1])


def wait_for_files() -> None:
    """Until nothing of this process is written any more."""
    for thread in threading.enumerate():
        if thread.name == "files":
            thread.join()
