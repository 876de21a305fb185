"""What keypoints change: the same drive by the sequence alone and with them, and the errors of keypoint poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from edge.feed import Feed
from edge.reference_map import MapSet
from edge_plugins.mapping.keypoint_rows import ASSUMED
from sim.datasets import USUAL_FOV
from sim.evaluation.pose_errors import PoseErrors
from sim.evaluation.recognition import Recognition, RecognitionScore
from sim.traverse import distances_m, driven_m


@dataclass(frozen=True)
class WithKeypoints:
    """alone, judged: the same drive by the sequence alone. errors: of poses. known: how many places have distances."""

    alone: Recognition
    judged: RecognitionScore | None
    errors: PoseErrors
    known: tuple[str, ...]


def facts(found: WithKeypoints, seen: Recognition) -> list[str]:
    """For people, in the order of what they ask. seen: with keypoints."""
    alone, both = (f"{100 * one.believed.mean():.0f} % ({first_words(one)})" for one in (found.alone, seen))
    return [
        *found.known,
        f"of all frames, {alone} are accepted by the sequence alone, {both} with keypoints",
        errors_words(found, seen),
    ]


def errors_words(found: WithKeypoints, seen: Recognition) -> str:
    """Errors of keypoint poses."""
    poses, errors = sum(one is not None for one in seen.keyframes), found.errors
    if not poses:
        return "no picture has a keypoint pose"
    if not errors.frames.size:
        return f"{poses} pictures have a keypoint pose; how accurate these are is unknown without positions"
    sizes = [np.percentile(np.abs(one), (50, 95)) for one in (errors.along_m, errors.cross_track_m)]
    along, cross = (f"{median:.2f} / {nearly:.2f} m" for median, nearly in sizes)
    return (
        f"{len(errors.frames)} pictures have a keypoint pose, off by {along} (median / 95 %) along-track and"
        f" {cross} cross-track from the recording's own positions"
    )


def why_none(reference: Feed) -> str:
    """Why a recording's map has no keypoints, and what to do."""
    name = reference.header.name
    return f"no keypoints: without positions or distances of {name}, how far away its points are is not known"


def assumed_words(maps: MapSet, seen: Recognition) -> list[str]:
    """What a known field of view would be worth, where the map's was assumed."""
    key = maps.headers[0].keypoints_key
    if key is None or not key.focal_sigma:
        return []
    beside_m = [abs(one.right_m) * key.focal_sigma for one in seen.keyframes if one is not None]
    worth = f"up to {np.percentile(beside_m, 95):.2f} m (1 sigma) nearer" if beside_m else "nearer"
    return [f"the field of view is {ASSUMED}: with --fov-deg DEG ({USUAL_FOV}) poses are {worth} cross-track"]


def first_words(seen: Recognition) -> str:
    """From where on a place is believed."""
    rows = np.flatnonzero(seen.believed)
    if not rows.size:
        return "never"
    frame = seen.used[rows[0]].frame
    at, unit = distances_m(seen.feed, [frame], driven_m(seen.feed))
    return f"first after {at[0]:.0f} {unit}"
