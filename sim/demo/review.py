"""The answers of the daemon to the frames that it used, compared with the truth."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.journal.records import FrameUsed, Stopped
from sim.evaluation.metrics import TOLERANCE_M, Answers
from sim.journal import records_of
from sim.vehicle.daemon_drive import DaemonDrive
from sim.world.camera import open_renderer


@dataclass(frozen=True)
class Review:
    """One drive; rows are the frames that the daemon used.

    route_m: (Q,) truth. error_m: (Q,) distance of the answer from the truth, NaN where there was none. pictures: of
    some frames, by row, rendered again.
    """

    seen: list[FrameUsed]
    route_m: NDArray[np.float64]
    error_m: NDArray[np.float64]
    pictures: dict[int, NDArray[np.uint8]]

    @property
    def answers(self) -> Answers:
        """For precision and recall: right within TOLERANCE_M; every frame counts as on the map, the warm-up too."""
        confidence = np.array([np.nan if seen.confidence is None else seen.confidence for seen in self.seen])
        return Answers(confidence, self.error_m <= TOLERANCE_M, np.ones(len(self.seen), dtype=bool))

    @property
    def accepted(self) -> NDArray[np.bool_]:
        """Frames whose match was accepted."""
        return np.array([seen.accepted for seen in self.seen])

    @property
    def precision(self) -> float:
        """Share of the accepted frames that are right."""
        return float((self.error_m[self.accepted] <= TOLERANCE_M).mean()) if self.accepted.any() else float("nan")

    @property
    def recall(self) -> float:
        """Share of all used frames that were accepted and right (`recall_of_places`)."""
        return float((self.accepted & (self.error_m <= TOLERANCE_M)).mean())


def used_frames(live: DaemonDrive) -> list[FrameUsed]:
    """Every frame that the daemon used, from its journal."""
    return list(records_of(live.journal, FrameUsed))


def median_95(errors_m: Sequence[float] | NDArray[np.float64]) -> str:
    """Of some errors, in words; a dash where there is none."""
    return f"{np.median(errors_m):.1f} m / {np.percentile(errors_m, 95):.1f} m" if len(errors_m) else "–"


def stages_ms(live: DaemonDrive) -> dict[str, float]:
    """Median time of each stage of a frame, from the last record of the daemon's journal."""
    return next(records_of(live.journal, Stopped)).stages_ms


def review_drive(live: DaemonDrive, pictures: int) -> Review:
    """Compare every used frame with the truth, and render `pictures` of the emitted ones again."""
    seen = used_frames(live)
    times_s = [item.stamp_ns / 1e9 - live.epoch_s for item in seen]
    errors_m = [
        np.nan if item.lat_deg is None or item.lon_deg is None else live.drive.error_m(t, item.lat_deg, item.lon_deg)
        for item, t in zip(seen, times_s, strict=True)
    ]
    emitted = [row for row, item in enumerate(seen) if item.emitted]
    shown = sorted(
        {emitted[at] for at in np.linspace(0, len(emitted) - 1, pictures).round().astype(int)} if emitted else ()
    )
    with closing(open_renderer(live.scenario, live.drive)) as renderer:
        kept = {row: renderer.render(live.drive.pose(times_s[row]), times_s[row]) for row in shown}
    route_m = np.array([live.drive.route_m(time_s) for time_s in times_s])
    return Review(seen, route_m, np.array(errors_m), kept)
