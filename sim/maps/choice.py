"""Which drives of a folder stay searched: at most so many layers of a road, for all lights and both ways of looking.

One drive after another is chosen, the one that adds most. On each of its stretches a drive adds

- how much better the layers then resemble what all drives saw there, those that are retired included (the mean over the
  drives of the cosine with the layer most alike): so the layers' lights are unlike each other;
- how many more of the recognized frames were of the best layer, light by light: so a layer stays that was good for one.

Nothing is added where enough layers pass, whichever way they look. First come drives without which NEEDED stretches or
more would have no layer that looks their way: the rear layer of the way home is not given up for a third front one.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from edge.reference_map import ReferenceMap
from edge_plugins.layers.road import NEEDED, REACH_M, Stretch
from sim.maps.use import Use

FIRST = 10.0
"""What a stretch counts without a layer: more than the two terms together, each of which is at most 1."""
LEAST_SHARE = 0.25
"""Of its stretches a drive is wanted on, or it is not searched at all: drives end some meters apart, nothing more."""


@dataclass
class _Open:
    """A stretch while layers are chosen: how alike the chosen are to each drive, and their best share by light."""

    stretch: Stretch
    order: dict[int, int]
    shares: dict[str, tuple[float, dict[int, float]]]
    alike: NDArray[np.float64]
    best_alike: NDArray[np.float64]
    best_share: dict[str, float] = field(default_factory=dict)
    has_layer: bool = False

    @classmethod
    def of(cls, stretch: Stretch, maps: Sequence[ReferenceMap], use: Use) -> _Open:
        """Without what is stale, where another drive shows what is there now."""
        stale = {number for number in stretch.rows if use.is_stale(stretch, number)}
        left = [number for number in stretch.rows if number not in stale] or list(stretch.rows)
        order = {number: layer for layer, number in enumerate(stretch.rows) if number in left}
        return cls(stretch, order, use.shares(stretch), stretch.alike(maps), np.zeros(len(stretch.rows)))

    def gain(self, number: int) -> float:
        """What a drive would add."""
        total = 0.0
        if number in self.order:
            total += float(np.maximum(self.alike[:, self.order[number]] - self.best_alike, 0.0).mean())
        return total + sum(more for _, more in self.more_recognized(number))

    def more_recognized(self, number: int) -> Iterator[tuple[str, float]]:
        """By light, how many more of all frames were a drive's than the best layer's."""
        for light, (weight, shares) in self.shares.items():
            yield light, weight * max(0.0, shares.get(number, 0.0) - self.best_share.get(light, 0.0))

    def add(self, number: int) -> None:
        """The drive is searched."""
        if number in self.order:
            self.has_layer = True
            np.maximum(self.best_alike, self.alike[:, self.order[number]], out=self.best_alike)
        for light, (_, shares) in self.shares.items():
            self.best_share[light] = max(shares.get(number, 0.0), self.best_share.get(light, 0.0))


@dataclass(frozen=True)
class Choice:
    """Why each drive is searched, or retired, by its number."""

    searched: dict[int, str]
    retired: dict[int, str]


def choose(
    road: Sequence[Stretch], maps: Sequence[ReferenceMap], use: Use, layers: int, forced: Mapping[int, str]
) -> Choice:
    """At most so many `layers` of each stretch, and more only where drives are `forced`, each for a reason."""
    opened, drives = [_Open.of(stretch, maps, use) for stretch in road], len(maps)
    passes: dict[int, list[_Open]] = {number: [] for number in range(drives)}
    for one in opened:
        for number in one.stretch.drives:
            passes[number].append(one)
    searched: dict[int, str] = {}

    def search(number: int, why: str) -> None:
        searched[number] = why
        for one in passes[number]:
            one.add(number)

    for number, why in forced.items():
        search(number, why)
    while len(searched) < drives:
        left = [number for number in range(drives) if number not in searched]
        gains = {number: _gain(number, passes[number], searched, layers) for number in left}
        best = max(left, key=lambda number: (gains[number][0], -number))
        gain, why = gains[best]
        if gain <= 0:
            break
        search(best, why)
    retired = [number for number in range(drives) if number not in searched]
    return Choice(searched, {number: _why_not(passes[number], number) for number in retired})


def _gain(number: int, stretches: Sequence[_Open], searched: Mapping[int, str], layers: int) -> tuple[float, str]:
    """What a drive adds, and why it is wanted most."""
    own = [one for one in stretches if number in one.order]
    if not own:
        return 0.0, ""
    bare = [one for one in own if not one.has_layer]
    needed = len(bare) >= min(NEEDED, len(own))
    wanted = [one for one in stretches if _layers(one.stretch, searched) < layers]
    share = sum(1 for one in wanted if number in one.order) / len(own)
    gain = sum(one.gain(number) for one in wanted) if share >= LEAST_SHARE else 0.0
    if needed:
        return gain + FIRST * len(bare), f"first to look this way, on {len(bare) * REACH_M:.0f} m"
    lights: dict[str, float] = {}
    for one in wanted:
        for light, more in one.more_recognized(number):
            lights[light] = lights.get(light, 0.0) + more
    light, most = max(lights.items(), key=lambda item: item[1], default=("", 0.0))
    return gain, f"recognized best when {light}" if most > gain / 2 else "unlike the other layers"


def _layers(stretch: Stretch, searched: Mapping[int, str]) -> int:
    return sum(1 for number in stretch.drives if number in searched)


def _why_not(stretches: Sequence[_Open], number: int) -> str:
    gone = sum(1 for one in stretches if number in one.stretch.rows and number not in one.order)
    return f"others serve its road{f'; {gone * REACH_M:.0f} m of it are no longer there' if gone else ''}"
