"""What threads of `edge.files.Behind` still write."""

from __future__ import annotations

import threading


def wait_for_files() -> None:
    """Until nothing of this process is written any more."""
    for thread in threading.enumerate():
        if thread.name == "files":
            thread.join()
