"""One drive: its events to the position estimator, and to a list where one is asked for. Pure.

The only place that changes the estimator. Whoever follows a drive (daemon, telemetry, plug-ins, a trial, a replay)
holds one of these.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

from msgspec import Struct

from edge.localization.events import Event, Fix, Limits
from edge.localization.position_estimator import Known, PositionEstimator
from edge.localization.refusals import Refusal
from edge.reference_map import Route


class Asked(Struct, frozen=True, tag=True):
    """A position was asked for, and this was the answer: changes nothing, and can be compared."""

    limits: Limits
    answer: Fix | Refusal


class Restored(Struct, frozen=True, tag=True):
    """A snapshot of an earlier run."""

    kept: bytes


Entry: TypeAlias = Event | Asked | Restored
"""Of the list of a drive."""


class Drive:
    """The events of one vehicle, in the order in which they came."""

    def __init__(self, estimator: PositionEstimator, write: Callable[[int, Entry], object] | None = None) -> None:
        """write: gets each entry of the list, with its time in ns of CLOCK_MONOTONIC."""
        self._estimator, self._write = estimator, write

    def update(self, t_ns: int, event: Event) -> None:
        """See `PositionEstimator.update`."""
        if self._write is not None:
            self._write(t_ns, event)
        self._estimator.update(t_ns, event)

    def fix(self, t_ns: int, limits: Limits) -> Fix | Refusal:
        """See `PositionEstimator.fix`."""
        answer = self._estimator.fix(t_ns, limits)
        if self._write is not None:
            self._write(t_ns, Asked(limits, answer))
        return answer

    def snapshot(self) -> bytes:
        """See `PositionEstimator.snapshot`."""
        return self._estimator.snapshot()

    def restore(self, t_ns: int, kept: bytes) -> None:
        """See `PositionEstimator.restore`."""
        if self._write is not None:
            self._write(t_ns, Restored(kept))
        self._estimator.restore(kept)

    @property
    def known(self) -> Known:
        """See `PositionEstimator.known`."""
        return self._estimator.known

    @property
    def route(self) -> Route:
        """The drives of the maps that are searched."""
        assert self._estimator.route is not None
        return self._estimator.route
