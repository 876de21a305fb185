"""The command `lookback` for the docs: a process that has imported its modules forks for each command.

Importing them takes each command 0.7 s of CPU, and the pages have 60 commands. A child runs `main` in the folder, with
the environment and on the streams of its caller, gets its caller's signals, and passes on the exit code.
"""

from __future__ import annotations

import importlib
import json
import os
import signal
import socket
import subprocess
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from edge.__main__ import main
from edge.commands.parser import COMMANDS

CALLER = """#!{python} -SE
import json, os, signal, socket, sys
server = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
server.connect({path!r})
socket.send_fds(server, [json.dumps([sys.argv[1:], os.getcwd(), dict(os.environ)]).encode()], [0, 1, 2])
child = int(server.recv(16))
for number in (signal.SIGTERM, signal.SIGINT):
    signal.signal(number, lambda number, frame: os.kill(child, number))
sys.exit(int(server.recv(16) or 1))
"""
ROOT = Path(__file__).parents[2]
REQUEST_BYTES = 1 << 17
"""Of a command line and its environment."""


@contextmanager
def forked_lookback(folder: Path) -> Iterator[Path]:
    """A folder with a program `lookback`, of which children run the commands until the context ends."""
    path = folder / "socket"
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listener:
        listener.bind(str(path))
        listener.listen()
        program = folder / "lookback"
        program.write_text(CALLER.format(python=sys.executable, path=str(path)))
        program.chmod(0o755)
        command = [sys.executable, "-m", __name__, str(listener.fileno())]
        server = subprocess.Popen(command, cwd=ROOT, pass_fds=[listener.fileno()], start_new_session=True)
    try:
        yield folder
    finally:
        os.killpg(server.pid, signal.SIGKILL)
        server.wait()


def serve(listener: socket.socket) -> None:
    """Fork for each command, for ever."""
    for module in (*COMMANDS.values(), "edge.daemon", "sim.commands", "sim.bench.board"):
        importlib.import_module(module)
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # nobody waits for them
    while True:
        caller, _ = listener.accept()
        request, streams, *_ = socket.recv_fds(caller, REQUEST_BYTES, 3)
        if os.fork() == 0:
            run(caller, request, streams)
        caller.close()
        for stream in streams:
            os.close(stream)


def run(caller: socket.socket, request: bytes, streams: list[int]) -> None:
    """Run the command of a request in this process, which ends with it."""
    words, folder, environment = json.loads(request)
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    for number, stream in enumerate(streams):
        os.dup2(stream, number)
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    caller.send(str(os.getpid()).encode())
    code = 1
    try:
        code = main(words)
        sys.stdout.flush()
    except SystemExit as ended:  # of argparse
        code = int(ended.code or 0)
    except BaseException:
        traceback.print_exc()
    caller.send(str(code).encode())
    os._exit(code)


if __name__ == "__main__":
    serve(socket.socket(fileno=int(sys.argv[1])))
