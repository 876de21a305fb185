"""A recognizer that never comes back: the loop stands, and nothing else feeds the watchdog."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from edge.config import load_config
from edge.daemon import Daemon
from edge.descriptor.network import Network
from edge.opened_parts import OpenedParts
from tests.common import PATIENCE_S


class HangingNetwork:
    """The shipped network, until it is told to hang."""

    def __init__(self, network: Network) -> None:
        self._network = network
        self.info, self.size, self.path, self.provider = network.info, network.size, network.path, network.provider
        self.hangs, self.let_go, self.hung = threading.Event(), threading.Event(), threading.Event()

    def describe(self, images: np.ndarray) -> np.ndarray:
        if self.hangs.is_set():
            self.hung.set()
            self.let_go.wait()
        return self._network.describe(images)


def test_a_network_that_hangs(
    calm_feed: Path,
    write_config: Callable[..., Path],
    grid: Network,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    manager = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    manager.bind(str(tmp_path / "notify"))
    manager.settimeout(PATIENCE_S)
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
    hanging, stop = HangingNetwork(grid), threading.Event()

    def turn_until_stopped() -> None:
        with ExitStack() as parts:
            config = load_config(write_config(camera={"device": str(calm_feed)}))
            daemon = Daemon(OpenedParts(config, parts, network=hanging))  # type: ignore[arg-type]
            while not stop.is_set() and daemon.turn():
                pass

    loop = threading.Thread(target=turn_until_stopped)
    loop.start()
    try:
        while manager.recv(4096) != b"WATCHDOG=1":
            pass
        hanging.hangs.set()
        assert hanging.hung.wait(PATIENCE_S)
        manager.setblocking(False)
        with pytest.raises(BlockingIOError):  # what was said before it hung
            while True:
                manager.recv(4096)
        manager.settimeout(2.0)
        with pytest.raises(TimeoutError):
            manager.recv(4096)
    finally:
        stop.set()
        hanging.let_go.set()
        loop.join()
        manager.close()
