"""The signals that end a program: of a service manager, and of a terminal."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Callable, Iterator
from types import FrameType

STOPS = (signal.SIGTERM, signal.SIGINT)


@contextlib.contextmanager
def on_stop_signal(then: Callable[[], object]) -> Iterator[None]:
    """Call `then` at the first SIGTERM or SIGINT; ignore all that follow.

    Signals come in pairs (timeout(1) sends two). The second would interrupt the handler of the first, and could
    deadlock on the lock of an Event that is being set.
    """
    stopped = False

    def handle(number: int, at: FrameType | None) -> None:
        nonlocal stopped
        stopped = True
        for each in STOPS:
            signal.signal(each, signal.SIG_IGN)
        then()

    before = [signal.signal(each, handle) for each in STOPS]
    try:
        yield
    finally:
        if not stopped:  # otherwise they stay ignored until the process ends
            for each, handler in zip(STOPS, before, strict=True):
                signal.signal(each, handler)
