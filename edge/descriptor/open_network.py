"""The network that [descriptor] names, on its provider; a provider is compared with the CPU before it is used.

Accelerators round otherwise than the CPU, and some drivers are wrong. Their descriptors of a few pictures are therefore
compared with the CPU's at each start: a provider that describes the same picture otherwise would find no place.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.config import DescriptorConfig
from edge.descriptor.model_file import read_model_file, resolve_model
from edge.descriptor.network import CPU, Network, provider_name
from edge.descriptor.normalize import normalize
from edge.errors import ModelError

PICTURES = 24
"""As many as NSD needs for its statistics to mean something; on a slow board they take a few seconds."""


def open_network(config: DescriptorConfig) -> Network:
    """Read, check and open the network. ModelError and ConfigError name in one line what cannot be used."""
    file = read_model_file(resolve_model(Path(config.model) if config.model else None))
    if config.provider == CPU:
        return Network(file)
    provider_name(config.provider)  # before the longer work
    network = Network(file, config.provider)
    check_agreement(Network(file), network)
    return network


def check_agreement(exact: Network, network: Network) -> None:
    """ModelError, with the cosine, unless two open networks describe the same pictures alike."""
    pictures = check_pictures(exact.size)
    one, other = (np.stack([each.describe(pair) for pair in pictures]) for each in (exact, network))
    cosine = float(nsd_cosines(one, other).mean())
    if not cosine >= NSD_COSINE_MIN:  # NaN is not
        raise ModelError(
            f'[descriptor] provider: the descriptors of "{network.provider}" differ from those of the CPU: cosine after'
            f' NSD {cosine:.4f}, and {NSD_COSINE_MIN} is needed; set provider = "{CPU}"'
        )


def check_pictures(size: tuple[int, int]) -> NDArray[np.uint8]:
    """Pictures (PICTURES, 2, height, width, 3), the same each time, with something in them at every scale."""
    random, (height, width) = np.random.default_rng(16), size
    pictures = np.zeros((PICTURES, 2, height, width, 3), np.float32)
    for index in np.ndindex(pictures.shape[:2]):
        for cells in (2, 7, 28):
            coarse = random.random((cells, cells, 3), np.float32)
            pictures[index] += 85 * cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    return np.clip(pictures, 0, 255).astype(np.uint8)


NSD_COSINE_MIN = 0.995
"""Descriptors whose mean cosine to the exact ones after NSD is below this are not good enough to use."""


def nsd_cosines(exact: NDArray[np.float32], other: NDArray[np.float32]) -> NDArray[np.float64]:
    """Cosines (N, R) of two networks' descriptors (N, R, D) of the same images, each set after its own NSD (eq. 1).

    NSD takes out what all images share, so it amplifies every error of rounding: these cosines count.
    """
    return cosines(normalized_set(exact), normalized_set(other))


def normalized_set(raw: NDArray[np.float32]) -> NDArray[np.float32]:
    """NSD of a whole set (N, R, D), over its first axis."""
    return normalize(raw, raw.mean(axis=0, dtype=np.float64), raw.std(axis=0, dtype=np.float64))


def cosines(first: NDArray[np.float32], second: NDArray[np.float32]) -> NDArray[np.float64]:
    """Cosine of each region of each frame, (N, R)."""
    products = np.einsum("nrd,nrd->nr", first, second, dtype=np.float64)
    norms = np.linalg.norm(first, axis=2).astype(np.float64) * np.linalg.norm(second, axis=2)
    return np.asarray(np.divide(products, norms, out=np.zeros_like(products), where=norms > 0))
