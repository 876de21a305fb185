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

from edge.descriptor import NormalizedRows
from edge.descriptor.network import Regions
from edge.descriptor.normalize import RunningStatistics, normalize
from edge.descriptor.open_network import normalized_set
from edge.errors import ConfigError
from edge.keypoints.network import MOST

Raw = NDArray[np.float32]


@dataclass(frozen=True)
class Method:
    """One row of the table.

    layer: "fc6" stands for the network's own descriptor; or "pixels" (SeqSLAM); or "matrix", of
    similarities that were made elsewhere. single: the best match of each frame alone, without a sequence.
    nsd: whether descriptors are normalized: the map over its whole set (eq. 1) and the query online (section III-B).
    recognizer: the row is what `lookback run` does, with its own matcher: the places that it believes with their
    confidence, or the best line of each frame with its uniqueness. Of all others, the region order of each frame is
    that of lower cost, as in the paper. keypoints: the ten best places are put in the order of the inliers of so many
    keypoints; 0: they are not. description: the row in words.
    """

    name: str
    description: str
    layer: Literal["fc6", "pixels", "matrix"] = "fc6"
    regions: Regions = "whole"
    nsd: bool = True
    recognizer: Literal["", "belief", "uniqueness"] = ""
    network: str = ""
    single: bool = False
    keypoints: int = 0


def _rows() -> Iterator[Method]:
    alone = "the whole image's descriptor, best match of each frame alone"
    yield Method("Raw-single", f"{alone}, not normalized", nsd=False, single=True)
    yield Method("NSD-single", f"{alone}, normalized", single=True)
    about = f"the ten best places of NSD-single, by the inliers of {MOST} keypoints"
    yield Method("Keypoints", about, single=True, keypoints=MOST)
    yield Method("Raw-fc6", "fc6 of the whole image, not normalized", nsd=False)
    yield Method("NSD-fc6", "fc6, normalized (reference over its set, query online)")
    yield Method("Raw-CR", "fc6 of left and right regions, not normalized", regions="left-right", nsd=False)
    yield Method("NSD-CR", "fc6 of left and right regions, normalized: the paper's best", regions="left-right")
    run = Method("Lookback", "as `lookback run`: the place belief", regions="left-right", recognizer="belief")
    yield run
    best_lines = "the best lines of the same run, by their uniqueness"
    yield replace(run, name="Lookback/uniqueness", description=best_lines, recognizer="uniqueness")
    yield Method("SeqSLAM", "as published: centered, forward only, its own parameters", "pixels", nsd=False)


METHODS: dict[str, Method] = {method.name: method for method in _rows()}


SEQUENCES = "/sequences"
"""After the name of similarities: with the search of sequences on them."""


def find_method(text: str, networks: Sequence[str], matrices: Collection[str] = ()) -> Method:
    """The row of that name, NAME or NAME@NETWORK, or of the similarities; ConfigError lists what there is."""
    if text.removesuffix(SEQUENCES) in matrices:
        is_single = not text.endswith(SEQUENCES)
        about = "similarities made elsewhere, " + ("best match of each frame alone" if is_single else "with sequences")
        return Method(text, about, "matrix", nsd=False, single=is_single)
    name, _, network = text.partition("@")
    network = network or networks[0]
    if network not in networks:
        raise ConfigError(f"method {text!r}: no network {network!r}; there are {', '.join(networks)}")
    if name not in METHODS:
        raise ConfigError(f"method {text!r}: no such row; there are {', '.join(METHODS)}")
    return replace(METHODS[name], name=text, network=network)


def reference_rows(method: Method, raw: Raw) -> Raw:
    """The reference's descriptors (N, R, D), normalized as the method has it."""
    # A map keeps raw descriptors in half precision and is normalized from those.
    raw = raw.astype(np.float16).astype(np.float32)
    return normalized_set(raw) if method.nsd else raw


def query_rows(method: Method, raw: Raw) -> Iterator[NormalizedRows]:
    """The row that each query frame adds to the ring, in order."""
    return normalized_online(raw) if method.nsd else (NormalizedRows(row[np.newaxis]) for row in raw)


def normalized_online(raw: Raw) -> Iterator[NormalizedRows]:
    """Each descriptor (R, D) by those up to it alone, as in the paper: what came before is not normalized again."""
    known = RunningStatistics((raw.shape[1], raw.shape[2]))
    for one in raw:
        known.update(one)
        yield NormalizedRows(normalize(one[np.newaxis], known.mean, known.deviation))
