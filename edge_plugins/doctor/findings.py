"""What the checks of `lookback doctor` share: what is examined, and what is found."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeAlias

import msgspec

from edge.config import Config
from edge.descriptor.network import Network
from edge.reference_map import MapSet
from edge.telemetry.vehicle import Vehicle

Level: TypeAlias = Literal["good", "note", "bad"]
Found: TypeAlias = tuple[Level, str, str]


class Finding(msgspec.Struct, frozen=True):
    """level: "bad" keeps `lookback run` from doing all of its work, "note" does not. remedy: "" if nothing is to do."""

    level: Level
    what: str
    words: str
    remedy: str = ""


@dataclass
class DoctorContext:
    """path: of the config, None where none was named. dev: where the devices are. seconds: to wait for the autopilot.

    What follows is found by one check for those after it. as_service: whether the rights are the service's.
    """

    path: Path | None
    dev: Path
    seconds: float
    as_service: bool = False
    config: Config | None = None
    network: Network | None = None
    maps: MapSet | None = None
    autopilot: Vehicle | None = None
    has_receiver: bool = False

    @property
    def settings(self) -> Config:
        """The config, or the default where none can be read."""
        return self.config or Config()


def good(words: str) -> Found:
    """It works."""
    return "good", words, ""


def note(words: str, remedy: str = "") -> Found:
    """It works, but differently than one may expect."""
    return "note", words, remedy


def bad(words: str, remedy: str) -> Found:
    """It does not work like this."""
    return "bad", words, remedy
