"""No test writes into the folders of an installed vehicle: every Python that a test starts refuses to, and says so.

`tests/conftest.py` installs it, and hands it to subprocesses by PYTHONPATH, where Python imports a module of this name.
"""

from __future__ import annotations

import os
import sys
from typing import Any

OF_THE_VEHICLE = ("/etc/lookback", "/run/lookback", "/var/lib/lookback")
WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT


def refuse(event: str, args: tuple[Any, ...]) -> None:
    """An audit hook (PEP 578): AssertionError before a file or folder of the vehicle is written."""
    if event == "os.mkdir" or (event == "open" and args[2] & WRITES):
        path = os.fsdecode(args[0]) if isinstance(args[0], str | bytes | os.PathLike) else ""
        if path.startswith(OF_THE_VEHICLE):
            raise AssertionError(
                f"a test would write {path}, which is a vehicle's own: name a file in tmp_path instead"
            )


sys.addaudithook(refuse)
