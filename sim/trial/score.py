"""What a run was worth, by the truth that only the simulator knows."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from edge.journal.records import FixAnswered, FixSent, FixWithheld, JournalLine, PlaceFix
from sim.vehicle.daemon_drive import DaemonDrive

MEDIAN_M, MOST_M, SIGMAS = 3.0, 10.0, 3.0
"""What a trial requires: of the autopilot's error after a fix the median and the 95th percentile; and of each fix, that
its error is no more than so many of the sigmas that were sent with it."""


@dataclass(frozen=True)
class RunScore:
    """One run.

    fix_error_m: of each fix sent, from where the vehicle was at its exposure. fix_sigmas: the same over the sigma that
    was sent. before_m, after_m: the autopilot's own error before and after each fix that it used. false_fixes,
    planted_seen: fixes and recognized places of the planted stretch. withheld: how often fixes began to be withheld,
    by reason. answers: how often the autopilot gave each answer.
    """

    seed: int
    light: str
    fix_error_m: tuple[float, ...]
    fix_sigmas: tuple[float, ...]
    before_m: tuple[float, ...]
    after_m: tuple[float, ...]
    false_fixes: int
    planted_seen: int
    withheld: dict[str, int]
    answers: dict[str, int]


def judge(seed: int, run: DaemonDrive, planted: tuple[int, int], journal: Sequence[JournalLine]) -> RunScore:
    """Compare the journal of a run, and what the autopilot did, with the true drive. planted: rows [start, end)."""
    records = [line.record for line in journal]
    sent = [record for record in records if isinstance(record, FixSent)]
    places = [record.place for record in records if isinstance(record, PlaceFix)]
    booted_s = run.autopilot.booted_s - run.epoch_s
    errors_m = [run.drive.error_m(booted_s + fix.send_boot_s - fix.age_s, fix.lat_deg, fix.lon_deg) for fix in sent]
    taken = run.autopilot.resets + run.autopilot.inputs.fused
    first, end = planted
    withheld = Counter(record.reason for record in records if isinstance(record, FixWithheld))
    answers = Counter(record.result for record in records if isinstance(record, FixAnswered))
    return RunScore(
        seed=seed,
        light=run.scenario.light,
        fix_error_m=tuple(errors_m),
        fix_sigmas=tuple(error / fix.sigma_m for error, fix in zip(errors_m, sent, strict=True)),
        before_m=tuple(item.error_before_m for item in taken),
        after_m=tuple(item.error_after_m for item in taken),
        false_fixes=sum(first <= fix.place < end for fix in sent),
        planted_seen=sum(first <= place < end for place in places),
        withheld=dict(withheld),
        answers=dict(answers),
    )


@dataclass(frozen=True)
class TrialScore:
    """All runs together."""

    runs: tuple[RunScore, ...]

    @property
    def after_m(self) -> np.ndarray:
        """The autopilot's error after each fix that it used."""
        return np.array([value for run in self.runs for value in run.after_m])

    @property
    def fix_sigmas(self) -> np.ndarray:
        """Each fix's error over its sigma."""
        return np.array([value for run in self.runs for value in run.fix_sigmas])

    @property
    def failures(self) -> list[str]:
        """What was asked for and is not so."""
        after_m, sigmas = self.after_m, self.fix_sigmas
        if not after_m.size:
            return ["no fix was used"]
        required = (
            (np.median(after_m) <= MEDIAN_M, f"median of the autopilot's error above {MEDIAN_M:g} m"),
            (np.percentile(after_m, 95) <= MOST_M, f"95 % of the autopilot's errors above {MOST_M:g} m"),
            (sigmas.max() <= SIGMAS, f"{(sigmas > SIGMAS).sum()} fixes more than {SIGMAS:g} sigma wrong"),
            (not sum(run.false_fixes for run in self.runs), "fixes of the planted false place"),
        )
        return [failure for good, failure in required if not good]

    def table(self) -> str:
        """The figures, for people."""
        after_m, sigmas = self.after_m, self.fix_sigmas
        errors_m = np.array([value for run in self.runs for value in run.fix_error_m])
        before_m = np.array([value for run in self.runs for value in run.before_m])
        if not after_m.size:
            return "no fix was used"
        lines = [
            f"runs                         {len(self.runs)}, fixes sent {len(errors_m)}, used {len(after_m)}",
            f"error of the fixes           {_spread(errors_m)}",
            f"autopilot before a fix       {_spread(before_m)}",
            f"autopilot after a fix        {_spread(after_m)}",
            f"error over sigma             rms {np.sqrt(np.mean(sigmas**2)):.2f}, largest {sigmas.max():.2f}",
            f"planted false place          recognized in {sum(bool(run.planted_seen) for run in self.runs)} runs,"
            f" sent {sum(run.false_fixes for run in self.runs)} times",
        ]
        return "\n".join(lines)


def _spread(errors_m: np.ndarray) -> str:
    return (
        f"median {np.median(errors_m):.2f} m, 95 % {np.percentile(errors_m, 95):.2f} m, largest {errors_m.max():.2f} m"
    )
