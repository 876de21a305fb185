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
from edge.descriptor.normalize import OnlineNormalizer
from edge.descriptor.open_network import normalized_set
from edge.errors import ConfigError

Raw = NDArray[np.float32]


@dataclass(frozen=True)
class Method:
    """One row of the table.

    layer: of the network; or "pixels" (SeqSLAM), or "external" (descriptors that another program made).
    nsd: how descriptors are normalized: not at all; the map over its whole set (eq. 1) and the query online (section
    III-B); or both over their whole sets ("batch").
    recognizer: the row is what `lookback run` does, with its own matcher: the places that it believes with their
    confidence, or the best line of each frame with its uniqueness. Of all others, the region order of each frame is
    that of lower cost, as in the paper. description: the row in words.
    """

    name: str
    description: str
    layer: Literal["conv3", "fc6", "external", "pixels"] = "fc6"
    regions: Regions = "whole"
    nsd: Literal["none", "online", "batch"] = "online"
    recognizer: Literal["", "belief", "uniqueness"] = ""
    network: str = ""
    external: str = ""


def _rows() -> Iterator[Method]:
    yield Method("Raw-conv3", "conv3 of the whole image, not normalized", "conv3", nsd="none")
    yield Method("NSD-conv3", "conv3, normalized (reference over its set, query online)", "conv3")
    yield Method("Raw-fc6", "fc6 of the whole image, not normalized", nsd="none")
    yield Method("NSD-fc6", "fc6, normalized (reference over its set, query online)")
    yield Method("Raw-CR", "fc6 of left and right regions, not normalized", regions="left-right", nsd="none")
    yield Method("NSD-CR", "fc6 of left and right regions, normalized: the paper's best", regions="left-right")
    yield Method("NSD-conv3/batch", "NSD-conv3, query over its whole set too", "conv3", nsd="batch")
    yield Method("NSD-fc6/batch", "NSD-fc6, query over its whole set too", nsd="batch")
    yield Method("NSD-CR/batch", "NSD-CR, query over its whole set too", regions="left-right", nsd="batch")
    run = Method("Lookback", "as `lookback run`: the place belief", regions="left-right", recognizer="belief")
    yield run
    best_lines = "the best lines of the same run, by their uniqueness"
    yield replace(run, name="Lookback/uniqueness", description=best_lines, recognizer="uniqueness")
    yield Method("SeqSLAM", "as published: centered, forward only, its own parameters", "pixels", nsd="none")


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


def reference_rows(method: Method, raw: Raw) -> Raw:
    """The reference's descriptors (N, R, D), normalized as the method has it."""
    # A map keeps raw descriptors in half precision and is normalized from those.
    raw = raw.astype(np.float16).astype(np.float32)
    return raw if method.nsd == "none" else normalized_set(raw)


def query_rows(method: Method, raw: Raw, length: int, starts: Collection[int] = ()) -> Iterator[NormalizedRows]:
    """The row that each query frame adds to the ring, in order.

    starts: frames that begin a new ring, as each drive does.
    """
    if method.nsd != "online":
        rows = raw if method.nsd == "none" else normalized_set(raw)
        yield from (NormalizedRows(row[np.newaxis]) for row in rows)
        return
    normalizer = OnlineNormalizer(length, renormalize_ring=False)
    for frame, one in enumerate(raw):
        if frame == 0 or frame in starts:
            normalizer.clear_ring()
        yield normalizer.push(one)
