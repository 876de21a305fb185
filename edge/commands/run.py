"""`lookback run`: recognize places and send positions to the autopilot, until stopped or the camera ends."""

from __future__ import annotations

import argparse
import logging
import os
import signal
import threading
from pathlib import Path

from edge.commands.stop_signal import on_stop_signal
from edge.config import load_config, naming
from edge.daemon import run

log = logging.getLogger(__name__)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of `lookback run`."""
    parser.add_argument("config", type=Path, metavar="CONFIG")
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    config = load_config(args.config)
    stop, reload = threading.Event(), threading.Event()
    if not os.isatty(0):  # at a terminal it means that the terminal is closed
        signal.signal(signal.SIGHUP, lambda number, at: reload.set())  # systemctl reload lookback
    with on_stop_signal(stop.set), naming(args.config):
        stopped = run(config, stop, reload)
    log.info("stopped: %d frames used, %d events", stopped.frames_used, stopped.events)
    return 0
