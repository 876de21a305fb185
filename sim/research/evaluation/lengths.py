"""How long lines should be whose votes are believed: 80 m, 40 m, or either; on simulated roads, a part of them mapped.

The roads, drives and errors of `sim.research.evaluation.belief`. The lines of each frame are searched once, and their
votes are added up in several ways.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from edge.config import Config, RigConfig
from edge.descriptor.network import Network
from edge.recognition.sequence_matcher import SequenceMatcher
from edge.reference_map import Drives, MapSet
from edge.sequence.consensus import ConsensusSettings, PlaceBelief, PlaceConsensus, PlaceVote
from edge.sequence.prior import Prior
from sim.research.evaluation.belief import GROUPS, cell, wrong_frames
from sim.research.evaluation.roads import (
    CALIBRATION,
    DEFAULT_SAMPLING,
    SPACING_M,
    Beliefs,
    BeliefScore,
    Case,
    Cut,
    DriveDescriptors,
    World,
    believe,
    driven,
    judge,
    kept,
    mapped,
    offset_m,
    rig_of,
    worlds,
)

PARTS: tuple[Cut, ...] = ("second half", "thirds")
Lines = list[tuple[tuple[PlaceVote | None, PlaceVote | None], bool]]
"""Of each frame the votes of the best lines of whole and of half sequences, and whether some were excluded."""


@dataclass(frozen=True)
class Voters:
    """Votes that are added up by themselves.

    halves: those of half a sequence. held: times the usual evidence per frame that is held against a place. reach:
    times the usual meters that votes count for.
    """

    halves: bool = False
    held: float = 1.0
    reach: float = 1.0

    def settings(self, usual: ConsensusSettings) -> ConsensusSettings:
        """Those of these voters."""
        own = usual.of_halves() if self.halves else usual
        reach, recent = self.reach * own.reach_lines, self.reach * own.recent_lines
        return replace(own, prior=self.held * own.prior, reach_lines=reach, recent_lines=recent)


USED = "either (what is used)"
WAYS: dict[str, Sequence[Voters]] = {
    "80 m": [Voters()],
    "40 m": [Voters(halves=True)],
    USED: [Voters(), Voters(halves=True)],
    "either, against 40 m as much evidence in all as against 80 m": [Voters(), Voters(halves=True, held=2.0)],
    "80 m, by the votes of 320, 160 or 80 m": [Voters(), Voters(reach=0.5), Voters(reach=0.25)],
}
"""Of several voters, the most certain is believed."""


def rows(args: argparse.Namespace) -> Iterator[str]:
    """How long lines should be: recall and meters to the first right belief by each way to add votes; what is wrong."""
    seen = worlds(args.seeds, args.length, args.cache, Network.load(Path("grid")))
    found: dict[tuple[str, Case], list[BeliefScore]] = {}
    for world in seen:
        for way, case, judged in _judged(world, args.draws):
            found.setdefault((way, case), []).append(judged)
    heads = [f"{words}: {part}" for words, _, _ in GROUPS for part in PARTS]
    yield f"| sequences of | {' | '.join(heads)} | wrong |"
    yield "|---|" + "---|" * (len(heads) + 1)
    for way in WAYS:
        cells = []
        for _, direction, lights in GROUPS:
            for part in PARTS:
                cells.append(cell([one for light in lights for one in found[way, (direction, light, part)]]))
        ones = [one for (name, _), of_case in found.items() if name == way for one in of_case]
        wrong, frames = sum(map(wrong_frames, ones)), sum(len(one.belief.correct) for one in ones)
        yield f"| {way} | {' | '.join(cells)} | {wrong} of {frames} |"


def _judged(world: World, draws: int) -> Iterator[tuple[str, Case, BeliefScore]]:
    road, drives = world
    for _, direction, lights in GROUPS:
        calibration = drives[CALIBRATION, direction]
        ahead_m = offset_m(calibration, believe(road, calibration, "whole"))
        for light in lights:
            query = drives[light, direction]
            for part in PARTS:
                mapped_m = np.concatenate([road.route_m[start:end] for start, end in kept(part, len(road.raw))])
                with mapped(road, part) as map_set:
                    lines = lines_of(map_set, query, rig_of(direction, ahead_m))
                    for (way, voters), draw in ((one, draw) for one in WAYS.items() for draw in range(draws)):
                        beliefs = believed_by(map_set, query, lines, voters, draw)
                        yield way, (direction, light, part), judge(query, mapped_m, beliefs, ahead_m)


def lines_of(map_set: MapSet, query: DriveDescriptors, rig: RigConfig) -> Lines:
    """What a drive sees on a map, without dead reckoning."""
    drives, found = Drives(map_set, SPACING_M), []
    for matcher, _ in driven(map_set, query, Config(rig=rig, sampling=DEFAULT_SAMPLING)):
        whole, half = (
            PlaceVote.of(line, drives, rig) if line else None for line in (matcher.best, matcher.search.shorter)
        )
        found.append(((whole, half), matcher.search.part is not None and matcher.search.part.excludes))
    return found


def believed_by(map_set: MapSet, query: DriveDescriptors, lines: Lines, voters: Sequence[Voters], draw: int) -> Beliefs:
    """What those voters believe; draw: seed of the errors of dead reckoning, from the start of the drive on."""
    drives, config = Drives(map_set, SPACING_M), Config(sampling=DEFAULT_SAMPLING)
    usual = ConsensusSettings.of(config, drives)
    several = [PlaceConsensus(one.settings(usual), drives.positions_m) for one in voters]
    part = SequenceMatcher(map_set, config).search.part
    assert part is not None  # such a map is searched whole
    along_m, confidence = np.full(len(lines), np.nan), np.zeros(len(lines))
    reckoned = query.reckoned(0.0, draw)
    for frame, ((votes, excludes), at) in enumerate(zip(lines, reckoned, strict=True)):
        usual = ConsensusSettings.of(config, drives, some_excluded=excludes)
        from_deg = at.lat_deg, at.lon_deg
        known = Prior(at.sigma_m, part.squares_m2(*from_deg)), partial(drives.away_m, from_deg=from_deg)
        beliefs: list[PlaceBelief] = []
        for one, consensus in zip(voters, several, strict=True):
            consensus.settings = one.settings(usual)
            belief = consensus.update(votes[one.halves], float(query.driven_m[frame]), 1.0, *known)
            beliefs += [belief] if belief else []
        if beliefs:
            best = max(beliefs, key=lambda belief: belief.confidence)
            along_m[frame], confidence[frame] = best.along_m, best.confidence
    return Beliefs(along_m, confidence, along_m, confidence, along_m, confidence)
