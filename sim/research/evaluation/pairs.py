"""Pictures of right and wrong answers: what a front camera saw, and the place of a rear camera's map it was matched to.

The roads and drives of `sim.research.evaluation.belief`: the same way, GPS lost where the drive begins. The frames are
chosen by the rules of `pairs`, not by hand.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from edge import __version__
from edge.config import AcceptanceConfig
from sim.research.evaluation.roads import (
    CALIBRATION,
    TOLERANCE_M,
    Cut,
    Floats,
    World,
    believe,
    kept,
    offset_m,
    rig_of,
    scenarios,
    worlds,
)
from sim.research.pictures import note
from sim.world.camera import open_renderer
from sim.world.scenario import LightName, Scenario

PANEL_PX, GAP_PX = (240, 180), 6
JPEG = (cv2.IMWRITE_JPEG_QUALITY, 80)
LEAST = AcceptanceConfig().confidence_from
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class MatchedPair:
    """A frame of a drive, and the row of the map that it was matched to.

    confidence: of the place, None where only a match alone is shown. words: what is to be said of the match.
    """

    name: str
    light: LightName
    frame: int
    row: int
    confidence: float | None
    words: str

    @property
    def said(self) -> str:
        """Whether the place is accepted, and with which confidence."""
        if self.confidence is None:
            return "not accepted"
        return f"{'accepted' if self.confidence >= LEAST else 'not accepted'}, {self.confidence:.2f}"


def pairs(world: World) -> Iterator[MatchedPair]:
    """The frames that are shown, at most one of each case."""
    road, drives = world
    by_day = drives[CALIBRATION, "forward"]
    ahead_m = offset_m(by_day, believe(road, by_day, "whole"))

    def shown(name: str, light: LightName, cut: Cut = "whole") -> Iterator[MatchedPair]:
        query = drives[light, "forward"]
        found = believe(road, query, cut, rig=rig_of("forward", ahead_m), reckoned=query.reckoned(0.0, 0))
        off_m, alone_m = found.along_m - ahead_m - query.route_m, found.match_m - ahead_m - query.route_m
        right, accepted = np.abs(off_m) <= TOLERANCE_M, found.confidence >= LEAST
        at_m, confidence, words = found.along_m, found.confidence, [f"right: {_off(one)}" for one in off_m]
        if name == "early":
            chosen = np.flatnonzero(right & ~np.logical_or.accumulate(accepted))[-1:]
            words = [f"{one}. Too few matches yet" for one in words]
        elif name == "outvoted":
            chosen = _ordered((np.abs(alone_m) > TOLERANCE_M) & right & accepted, np.abs(alone_m))[-1:]
            at_m, confidence = found.match_m, np.full(len(at_m), np.nan)
            words = [f"wrong: {_off(one)}. Earlier matches outvote it" for one in alone_m]
        elif name == "unmapped":
            mapped_m = np.concatenate([road.route_m[start:end] for start, end in kept(cut, len(road.raw))])
            beyond_m = np.abs(mapped_m - (query.route_m + ahead_m)[:, np.newaxis]).min(axis=1)
            chosen = _ordered((beyond_m > TOLERANCE_M) & ~accepted, found.uniqueness)[-1:]
            at_m, confidence = found.match_m, np.full(len(at_m), np.nan)
            words = [f"wrong: the map has no place within {one:.0f} m" for one in beyond_m]
        else:
            ordered = _ordered(right & accepted, confidence)
            chosen = ordered[len(ordered) // 2 :][:1]  # of median confidence
        for frame in chosen:
            row, claimed = int(np.abs(road.route_m - at_m[frame]).argmin()), float(confidence[frame])
            yield MatchedPair(name, light, int(frame), row, None if np.isnan(claimed) else claimed, words[frame])

    for light in ("dusk", "night", "rain"):
        yield from shown(light, light)
    yield from shown("early", "snow")
    yield from shown("outvoted", "night")
    yield from shown("unmapped", "dusk", "thirds")


def _off(off_m: float) -> str:
    return f"{abs(off_m):.0f} m {'ahead' if off_m > 0 else 'behind'}"


def _ordered(those: Mask, values: Floats) -> NDArray[np.intp]:
    """Those frames by their value, NaN last."""
    frames = np.flatnonzero(those)
    return frames[np.argsort(values[frames], kind="stable")]


def rows(args: argparse.Namespace) -> Iterator[str]:
    """Pictures of right and wrong answers by opposite views: the front camera's, and the matched place's on the map."""
    seeds = " ".join(map(str, args.seeds))
    yield f"`python -m sim.research.evaluation pairs --seeds {seeds}` of version {__version__}:"
    yield ""
    yield "| pictures | place | match |"
    yield "|---|---|---|"
    for seed, world in zip(args.seeds, worlds(args.seeds, args.length, args.cache), strict=True):
        (mapping, driving), (road, drives) = scenarios(seed, args.length), world
        for pair in pairs(world):
            driven_m = drives[pair.light, "forward"].driven_m[pair.frame], road.driven_m[pair.row]
            scenes = zip((driving[pair.light, "forward"], mapping), driven_m, strict=True)
            name = f"pair_{seed}_{pair.name}.jpg"
            row = f"| ![{pair.light}](pictures/{name}) | {pair.light}: {pair.said} | {pair.words} |"
            (args.pictures / name).write_bytes(_joined([_seen(scene, float(at_m)) for scene, at_m in scenes]))
            note(args.pictures, name, checksum_of_pair(args.pictures, row))
            yield row


def checksum_of_pair(folder: Path, row: str) -> str:
    """Of a row of the table and its picture in that folder: neither may change without the other."""
    name = row.partition("(pictures/")[2].partition(")")[0]
    return sha256((folder / name).read_bytes() + row.encode()).hexdigest()[:16]


def _seen(scenario: Scenario, driven_m: float) -> NDArray[np.uint8]:
    drive = scenario.drive()
    renderer, time_s = open_renderer(scenario, drive), drive.time_at_s(driven_m)
    picture = renderer.render(drive.pose(time_s, 0.0), time_s)
    renderer.close()
    return np.asarray(cv2.resize(picture, PANEL_PX, interpolation=cv2.INTER_AREA), np.uint8)


def _joined(pictures: Sequence[NDArray[np.uint8]]) -> bytes:
    """Side by side, as JPEG."""
    gap = np.full((PANEL_PX[1], GAP_PX, 3), 255, np.uint8)
    return cv2.imencode(".jpg", np.hstack([pictures[0], gap, pictures[1]]), JPEG)[1].tobytes()
