"""`lookback dev gps`: compare honest and spoofed GPS with the places of simulated drives.

How soon a spoofed GPS is called wrong, and how often an honest one.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path

import msgspec
import numpy as np

from edge.config import FIRST_NETWORK
from edge.descriptor.network import Network
from sim.research.trial.gps_drives import CALLED_M, DRIVES, WORLDS, Outcome, PlacedDrive, build_map, judge, place
from sim.research.trial.gps_histories import DRAG_MPS, TURNS_DEG, History, drag, jammed, jump, multipath, replay, rtk
from sim.trial.views import RoadLibrary

LEAST_CALLED = 0.9
"""Share of the drag-offs with sightings of which the pilot must be told in time; of 190, 0.93 were called: all by
night and dusk, 0.93 in rain, 0.70 in snow."""


class GpsTrial:
    """The drives that histories are held against, each recognized when it is first asked for."""

    def __init__(self, folder: Path, worlds: Sequence[int], drives: int) -> None:
        """folder: keeps rendered views. drives: how many different ones."""
        self._network = Network.load(Path(FIRST_NETWORK))
        self.library = RoadLibrary(self._network, folder / "views")
        self._folder, self._worlds, self._drives = folder, worlds, drives
        self._placed = cache(self._place)

    def _place(self, number: int, history: History | None = None) -> PlacedDrive:
        """Drive `number` of as many as wanted: its road, light, map, speed and odometer are its own."""
        world = self._worlds[number % len(self._worlds)]
        scenario = msgspec.structs.replace(DRIVES[number // len(self._worlds) % len(DRIVES)], seed=world)
        path = build_map(world, number, self._folder, self.library, self._network)
        return place(scenario, path, number, self.library, history)

    def honest(self, kilometers: float) -> Iterator[Outcome]:
        """Honest GPS on streets over so many kilometers."""
        driven_m, seed = 0.0, 0
        while driven_m < 1000.0 * kilometers:
            one = self._placed(seed % self._drives)
            history = rtk if seed % 10 == 9 else multipath
            outcome = judge(one, history(one.time_s, one.true_m, np.random.default_rng([seed, 1])))
            driven_m, seed = driven_m + outcome.driven_m, seed + 1
            yield outcome

    def drags(self, count: int, *, gps_velocity: bool) -> Iterator[tuple[float, str, Outcome]]:
        """Drag-offs of every rate and direction in turn, on drives that are long enough for 60 m."""
        kinds = [(rate, way) for rate in DRAG_MPS for way in TURNS_DEG]
        found = number = 0
        while found < count:
            (rate_mps, way), number = kinds[found % len(kinds)], number + 1
            one = self._placed(number % self._drives)
            start_s = float(np.random.default_rng([number, 2]).uniform(0.2, 0.4)) * one.time_s[-1]
            if rate_mps * (one.time_s[-1] - start_s) < 60.0:
                continue
            history, found = drag(rate_mps, way, start_s), found + 1
            if gps_velocity:
                one = self._place(number % self._drives, history)
            yield rate_mps, way, judge(one, history(one.time_s, one.true_m, np.random.default_rng([number, 3])))

    def spoofed(self) -> Iterator[tuple[str, Outcome]]:
        """Everything but drag-offs, once on each drive."""
        for number in range(self._drives):
            one = self._placed(number)
            start_s = 0.4 * one.time_s[-1]
            spoofs = {
                "jump of 40 m": jump(40.0, start_s),
                "jump of 500 m": jump(500.0, start_s),
                "replay of 30 s before": replay(30.0, start_s),
                "jammed for 10 s, then 60 m off": jammed(10.0, jump(60.0, start_s), start_s),
                "constant 40 m from the start": jump(40.0, 0.0),
            }
            for name, history in spoofs.items():
                yield name, judge(one, history(one.time_s, one.true_m, np.random.default_rng([number, 4])))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of `lookback dev gps`."""
    parser.add_argument("--drag-offs", type=int, default=200, metavar="N", help="drag-offs (default 200)")
    parser.add_argument("--honest-km", type=float, default=200.0, metavar="KM", help="of honest GPS (default 200)")
    parser.add_argument("--drives", type=int, default=20, metavar="N", help="different drives (default 20)")
    roads = f"roads (default {' '.join(map(str, WORLDS))})"
    parser.add_argument("--worlds", type=int, nargs="+", default=WORLDS, metavar="SEED", help=roads)
    slow = "the odometer is the velocity of GPS, not of wheels (slow)"
    parser.add_argument("--gps-velocity", action="store_true", help=slow)
    kept = "keeps rendered views and maps"
    parser.add_argument("-o", "--output", type=Path, default=Path("gps"), metavar="FOLDER", help=kept)
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    args.output.mkdir(parents=True, exist_ok=True)
    trial = GpsTrial(args.output, args.worlds, args.drives)
    try:
        honest = list(trial.honest(args.honest_km))
        trial.library.save()
        false = sum(not math.isnan(one.called_m) for one in honest)
        doubt = max((one.doubt for one in honest), default=0.0)
        kilometers = sum(one.driven_m for one in honest) / 1000
        told = sum(not math.isnan(one.told_m) for one in honest)
        print(
            f"honest: {kilometers:.0f} km, {false} false calls, {told} times told, greatest doubt {doubt:.2f}",
            flush=True,
        )
        for light in dict.fromkeys(one.light for one in honest):
            warned = [one.warned for one in honest if one.light == light]
            print(f"honest, {light}: not recognized where GPS was in {sum(warned)} of {len(warned)} drives", flush=True)
        drags = list(trial.drags(args.drag_offs, gps_velocity=args.gps_velocity))
        _print_drags(drags)
        _print_spoofs(list(trial.spoofed()))
    finally:
        trial.library.close()
    seen = [one for _, _, one in drags if one.seen]
    return 0 if not false and np.mean([one.told_m < CALLED_M for one in seen]) >= LEAST_CALLED else 1


def _print_spoofs(spoofs: Sequence[tuple[str, Outcome]]) -> None:
    for name in dict.fromkeys(name for name, _ in spoofs):
        found = [one for kind, one in spoofs if kind == name]
        after_m = [one.called_after_m for one in found if not math.isnan(one.called_m)]
        spread = f", after {np.median(after_m):.0f} m (median), {max(after_m):.0f} m at most" if after_m else ""
        print(f"{name}: {len(after_m)} of {len(found)} called{spread}", flush=True)


def _print_drags(drags: Sequence[tuple[float, str, Outcome]]) -> None:
    print("| drag-off | n | told before 50 m | with sightings | called wrong | error when told, median / 90 % |")
    print("|---|---|---|---|---|---|")
    rows: dict[str, list[Outcome]] = {name: [] for name in (*(f"{rate:g} m/s" for rate in DRAG_MPS), *TURNS_DEG)}
    for rate, way, one in drags:
        for name in (f"{rate:g} m/s", way, one.light):
            rows.setdefault(name, []).append(one)
    for name, found in (rows | {"all": [one for *_, one in drags]}).items():
        if not found:
            continue
        seen = [one for one in found if one.seen]
        errors_m = np.nan_to_num([one.told_m for one in found], nan=math.inf)
        in_time = [sum(one.told_m < CALLED_M for one in those) for those in (found, seen)]
        called = sum(not math.isnan(one.called_m) for one in found)
        spread = f"{np.median(errors_m):.0f} / {np.percentile(errors_m, 90, method='lower'):.0f} m"
        print(
            f"| {name} | {len(found)} | {in_time[0]} | {in_time[1]} of {len(seen)} | {called} | {spread} |", flush=True
        )
