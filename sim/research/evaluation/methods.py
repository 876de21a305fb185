"""The table of methods: a named row for each, and how it normalizes raw descriptors.

In: raw descriptors (n, R, D) of a whole traverse. Out: those of the reference, and of the query frame by frame, as
input of the recognizer's cost matcher and search.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from edge.descriptor import NormalizedRows, RunningStatistics
from edge.descriptor.network import Regions
from edge.descriptor.normalize import OnlineNormalizer, normalize
from edge.errors import ConfigError

Raw = NDArray[np.float32]
Runs = Sequence[tuple[int, int]]


@dataclass(frozen=True)
class Method:
    """One row of the table.

    layer: of the network; or "pixels" (SeqSLAM), or "external" (descriptors that another program made).
    reference: how the map is normalized: not at all, over its whole set (eq. 1), or within semantic segments.
    query: the same; or online (section III-B), or online with the ring normalized again ("ring", Lookback's default).
    deviation: False subtracts the mean only. warm: statistics continue those of an earlier drive.
    order: the lower cost of the two region orders in each frame (the paper), one order for a whole sequence, or the
    one that the two cameras' views allow in that direction of travel ("rig").
    recognizer: the row is what `lookback run` does, with its own matcher: the places that it believes with their
    confidence, or the best line of each frame with its uniqueness.
    centered: SeqSLAM uses frames half a sequence ahead, and the forward direction only, as published; otherwise only
    earlier frames, and both directions. description: the row in words.
    """

    name: str
    description: str
    layer: Literal["conv3", "fc6", "external", "pixels"] = "fc6"
    regions: Regions = "whole"
    reference: Literal["none", "set", "segments"] = "set"
    query: Literal["none", "set", "segments", "online", "ring"] = "online"
    deviation: bool = True
    warm: bool = False
    order: Literal["frame", "sequence", "rig"] = "frame"
    recognizer: Literal["", "belief", "uniqueness"] = ""
    centered: bool = False
    network: str = ""
    external: str = ""


def _raw(method: Method) -> Method:
    return replace(method, reference="none", query="none")


def _rows() -> Iterator[Method]:
    yield _raw(Method("Raw-conv3", "conv3 of the whole image, not normalized", "conv3"))
    yield Method("NSD-conv3", "conv3, normalized (reference over its set, query online)", "conv3")
    yield _raw(Method("Raw-fc6", "fc6 of the whole image, not normalized"))
    yield Method("NSD-fc6", "fc6, normalized (reference over its set, query online)")
    yield _raw(Method("Raw-CR", "fc6 of left and right regions, not normalized", regions="left-right"))
    yield Method("NSD-CR", "fc6 of left and right regions, normalized: the paper's best", regions="left-right")
    yield Method("NSD-conv3/batch", "NSD-conv3, query over its whole set too", "conv3", query="set")
    yield Method("NSD-fc6/batch", "NSD-fc6, query over its whole set too", query="set")
    yield Method("NSD-CR/batch", "NSD-CR, query over its whole set too", regions="left-right", query="set")
    yield Method("NSD-fc6/ring", "NSD-fc6, the ring normalized again", query="ring")
    yield Method("NSD-CR/ring", "NSD-CR, the ring normalized again", regions="left-right", query="ring")
    yield Method("NSD-CR/order", "NSD-CR, one region order a sequence", regions="left-right", order="sequence")
    run = Method("Lookback", "as `lookback run`: the place belief", regions="left-right", query="ring", order="rig")
    yield replace(run, recognizer="belief")
    yield replace(
        run,
        name="Lookback/uniqueness",
        description="the best lines of the same run, by their uniqueness",
        recognizer="uniqueness",
    )
    yield Method("mean-fc6", "fc6 minus its mean, query online", deviation=False)
    yield Method("mean-fc6/batch", "fc6 minus its mean, both over their sets", query="set", deviation=False)
    warm = Method(
        "NSD-fc6/warm", "NSD-fc6/ring, its statistics continuing those of an earlier drive", query="ring", warm=True
    )
    yield warm
    yield replace(
        warm,
        name="NSD-CR/warm",
        description="NSD-CR/ring, its statistics continuing too",
        regions="left-right",
    )
    yield Method("NSD-fc6/segments", "fc6, normalized within semantic segments", reference="segments", query="segments")
    yield _raw(Method("SeqSLAM", "as published: centered, forward only, its own parameters", "pixels", centered=True))
    yield _raw(Method("SeqSLAM/causal", "SeqSLAM without later frames, both directions", "pixels"))


METHODS: dict[str, Method] = {method.name: method for method in _rows()}


def find_method(text: str, networks: Sequence[str], external: Sequence[str]) -> Method:
    """The row of that name: NAME, NAME@NETWORK, or Raw-X and NSD-X[/batch] of external descriptors X.

    ConfigError lists what there is.
    """
    name, _, network = text.partition("@")
    network = network or networks[0]
    if network not in networks:
        raise ConfigError(f"method {text!r}: no network {network!r}; there are {', '.join(networks)}")
    if name in METHODS:
        return replace(METHODS[name], name=text, network=network)
    form, _, rest = name.partition("-")
    source, _, batch = rest.partition("/")
    if source in external and (form, batch) in (("Raw", ""), ("NSD", ""), ("NSD", "batch")):
        pattern = METHODS[f"{form}-fc6{'/batch' if batch else ''}"]
        return replace(pattern, name=text, description=f"{source} in place of fc6", layer="external", external=source)
    raise ConfigError(f"method {text!r}: no such row; there are {', '.join(METHODS)}, and Raw-X, NSD-X of external X")


def needs_segments(method: Method) -> bool:
    """Whether the method normalizes within semantic segments."""
    return "segments" in (method.reference, method.query)


def reference_rows(method: Method, raw: Raw, segments: Runs) -> Raw:
    """The reference's descriptors (N, R, D), normalized as the method has it."""
    # A map keeps raw descriptors in half precision and is normalized from those.
    raw = raw.astype(np.float16).astype(np.float32)
    if method.reference == "none":
        return raw
    return _normalized_apart(raw, segments if method.reference == "segments" else [(0, len(raw))], method.deviation)


def query_rows(
    method: Method,
    raw: Raw,
    length: int,
    *,
    segments: Runs = (),
    earlier: Raw | None = None,
    starts: Collection[int] = (),
) -> Iterator[NormalizedRows]:
    """The rows that each query frame adds to the ring or replaces in it, in order.

    earlier: raw descriptors of the drive whose statistics a warm method starts with. starts: frames that begin a new
    ring, as each drive does.
    """
    if method.query in ("none", "set", "segments"):
        apart = segments if method.query == "segments" else [(0, len(raw))]
        rows = raw if method.query == "none" else _normalized_apart(raw, apart, method.deviation)
        yield from (NormalizedRows(row[np.newaxis]) for row in rows)
    elif not method.deviation:
        yield from _mean_only(raw)
    else:
        # A ring of one frame is normalized with the newest statistics anyway.
        normalizer = OnlineNormalizer(length, renormalize_ring=method.query == "ring" and length > 1)
        for one in earlier if method.warm and earlier is not None else ():
            normalizer.push(one)
        for frame, one in enumerate(raw):
            if frame == 0 or frame in starts:
                normalizer.clear_ring()
            yield normalizer.push(one)


def _normalized_apart(raw: Raw, runs: Runs, deviation: bool) -> Raw:
    """Equation 1 within each run of frames."""
    out = np.empty_like(raw)
    for start, end in runs:
        part = raw[start:end]
        spread = part.std(axis=0, dtype=np.float64) if deviation else np.ones(raw.shape[1:])
        out[start:end] = normalize(part, part.mean(axis=0, dtype=np.float64), spread)
    return out


def _mean_only(raw: Raw) -> Iterator[NormalizedRows]:
    statistics = RunningStatistics((raw.shape[1], raw.shape[2]))
    for one in raw:
        statistics.update(one)
        rows = normalize(one[np.newaxis], statistics.mean, np.ones(one.shape))
        yield NormalizedRows(rows)


CHANGE = 0.01
"""Once in 100 frames, 200 m at 2 m a frame. [29] does not give its transition probabilities."""

SHORTEST = 10
"""Frames; mean and deviation of fewer say nothing, so a shorter run joins the one before it."""


def likeliest_states(probabilities: NDArray[np.floating], change: float = CHANGE) -> NDArray[np.intp]:
    """The likeliest sequence of categories (Viterbi), (n,), given probabilities (n, C) of each frame alone."""
    count, states = probabilities.shape
    seen = np.log(np.maximum(probabilities.astype(np.float64), 1e-12))
    stay, leave = np.log1p(-change), np.log(change / max(states - 1, 1))
    score = seen[0]
    came_from = np.zeros((count, states), dtype=np.intp)
    for frame in range(1, count):
        # All changes cost alike, so the best state to come from is either the same one or the best of all.
        best = int(score.argmax())
        stays = score + stay >= score[best] + leave
        came_from[frame] = np.where(stays, np.arange(states), best)
        score = np.where(stays, score + stay, score[best] + leave) + seen[frame]
    path = np.empty(count, dtype=np.intp)
    path[-1] = score.argmax()
    for frame in range(count - 1, 0, -1):
        path[frame - 1] = came_from[frame, path[frame]]
    return path


def runs(states: NDArray[np.intp], shortest: int = SHORTEST) -> list[tuple[int, int]]:
    """[start, end) of each run of one state; runs below `shortest` frames join the one before, the first the next."""
    starts = [0, *(np.flatnonzero(np.diff(states)) + 1).tolist()]
    found = list(zip(starts, [*starts[1:], len(states)], strict=True))
    joined = found[:1]
    for start, end in found[1:]:
        before, _ = joined[-1]
        if end - start < shortest or joined[-1][1] - before < shortest:
            joined[-1] = (before, end)
        else:
            joined.append((start, end))
    return joined
