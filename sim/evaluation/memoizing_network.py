"""The network with a memory: a picture that it has described before is not computed again."""

from __future__ import annotations

from hashlib import blake2b
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edge.descriptor.network import CPU, Network


class MemoizingNetwork(Network):
    """For runs that share most of their pictures: 32 KB a frame of two regions stay in memory."""

    _known: dict[bytes, NDArray[np.float32]]

    @classmethod
    def load(cls, path: Path | None = None, provider: str = CPU) -> MemoizingNetwork:
        """See Network."""
        network = super().load(path, provider)
        assert isinstance(network, MemoizingNetwork)
        network._known = {}
        return network

    def describe(self, images: NDArray[np.uint8]) -> NDArray[np.float32]:
        """See Network; the answer is bit for bit that of the network, and read-only, since others get the same."""
        key = blake2b(images.tobytes(), digest_size=16).digest()
        if key not in self._known:
            self._known[key] = super().describe(images)
            self._known[key].flags.writeable = False
        return self._known[key]
