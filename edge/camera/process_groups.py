"""The commands that cameras run, each the leader of a process group, which the main thread ends.

A camera's thread may wait in a read, or end with the process, and leave its command with the device in its hands.
"""

from __future__ import annotations

import contextlib
import os
import signal

STARTED: dict[int, int] = {}
"""Groups, and the thread that started each; one is removed before its number may become that of another."""


def send(number: signal.Signals, thread: int | None = None) -> None:
    """Send a signal to all groups that a thread has started; None: to those of all threads."""
    for group, by in list(STARTED.items()):
        if thread in (None, by):
            with contextlib.suppress(ProcessLookupError):
                os.killpg(group, number)
