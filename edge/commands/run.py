"""`lookback run`: recognize places and send positions to the autopilot, until stopped or the camera ends."""

from __future__ import annotations

import argparse
import logging
import os
import signal
import threading
from pathlib import Path

from edge.camera import process_groups
from edge.commands.stop_signal import on_stop_signal
from edge.config import load_config, naming
from edge.daemon import run

END_S = 4.0
"""From the signal to the end of the process; systemd kills it after 5 s (TimeoutStopSec=), which is no clean end."""
log = logging.getLogger(__name__)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of `lookback run`."""
    parser.add_argument("config", type=Path, metavar="CONFIG", help="settings; `lookback config` prints some")
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    config = load_config(args.config)
    stop, reload, opened = threading.Event(), threading.Event(), threading.Event()

    def end() -> None:
        stop.set()
        if not opened.is_set():  # a network, a map or a camera may take seconds: what is open by now is closed
            raise SystemExit(0)

    if not os.isatty(0):  # at a terminal it means that the terminal is closed
        signal.signal(signal.SIGHUP, lambda number, at: reload.set())  # systemctl reload lookback
    ended = threading.Event()
    threading.Thread(target=_end_in_time, args=(stop, ended), name="end", daemon=True).start()
    with on_stop_signal(end), naming(args.config):
        stopped = run(config, stop, reload, opened)
    ended.set()
    log.info("stopped: %d frames used, %d events", stopped.frames_used, stopped.events)
    return 0


def _end_in_time(stop: threading.Event, ended: threading.Event) -> None:
    """End the process for a disk, or a camera, that does not let it end; all files are whole at any moment."""
    stop.wait()
    if not ended.wait(END_S):
        log.warning("stopped, without what the disk did not take within %g s", END_S)
        process_groups.send(signal.SIGKILL)
        os._exit(0)
