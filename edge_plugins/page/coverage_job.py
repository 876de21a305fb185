"""The coverage of the map for the page: `lookback map coverage` as a process of its own, at the lowest priority.

It takes seconds to minutes of a core, which the daemon's process must not lose.
"""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path
from typing import Literal, TypeAlias

import msgspec

NICEST = "19"
LONGEST_S = 1800.0
State: TypeAlias = Literal["computing", "ready", "failed", "busy"]


class CoverageAnswer(msgspec.Struct, frozen=True):
    """What is known for some conditions. why: it failed. sheet: what the command printed, a JSON object.

    done: share of the drives that have been rehearsed, 0 to 1.
    """

    state: State
    why: str = ""
    done: float = 0.0
    sheet: msgspec.Raw = msgspec.Raw(b"null")


class CoverageJob:
    """One process at a time; what it found is kept until the maps change."""

    def __init__(self) -> None:
        self._answers: dict[tuple[Path, str, str, str], CoverageAnswer] = {}
        self._task: asyncio.Task[None] | None = None

    def answer(self, path: Path, way: str, light: str, view: str) -> CoverageAnswer:
        """For a drive over the maps at a path; begins to compute it if nobody has asked before."""
        key = path, way, light, view
        if key not in self._answers:
            if self._task is not None and not self._task.done():
                return CoverageAnswer("busy", "another one is being computed")
            self._answers[key] = CoverageAnswer("computing")
            self._task = asyncio.get_running_loop().create_task(self._compute(key))
        found = self._answers[key]
        if found.state == "failed":
            del self._answers[key]  # the next one to ask tries again
        return found

    async def close(self) -> None:
        """End what is being computed."""
        if self._task is not None:
            self._task.cancel()
            await asyncio.wait([self._task])

    async def _compute(self, key: tuple[Path, str, str, str]) -> None:
        path, way, light, view = key
        command = [sys.executable, "-I", "-m", "edge", "map", "coverage", str(path), "--json"]
        options = ["--for", way, "--light", light, "--view", view]
        try:
            process = await asyncio.create_subprocess_exec(
                "nice", "-n", NICEST, *command, *options, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE
            )
        except OSError as error:
            self._answers[key] = CoverageAnswer("failed", f"cannot start it: {error.strerror}")
            return
        assert process.stdout is not None and process.stderr is not None
        said = asyncio.ensure_future(self._follow(key, process.stderr))
        try:
            out = await asyncio.wait_for(process.stdout.read(), LONGEST_S)
        except asyncio.TimeoutError:
            self._answers[key] = CoverageAnswer("failed", "it took too long")
            return
        finally:
            if process.returncode is None and not process.stdout.at_eof():
                process.kill()
            await process.wait()
            await asyncio.wait([said])
        if process.returncode == 0:
            self._answers[key] = CoverageAnswer("ready", sheet=msgspec.Raw(out))
        else:
            self._answers[key] = CoverageAnswer("failed", said.result().strip()[-500:])

    async def _follow(self, key: tuple[Path, str, str, str], lines: asyncio.StreamReader) -> str:
        """Keep what is done by lines such as "done 0.25"; all other lines."""
        others = []
        async for line in lines:
            words = line.decode(errors="replace")
            if words.startswith("done "):
                self._answers[key] = CoverageAnswer("computing", done=float(words[5:]))
            else:
                others.append(words)
        return "".join(others)
