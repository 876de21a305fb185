"""What a trained network is worth on pictures that it has not learned from, and the ranges of its layers for int8."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor, nn

from sim.research.alexnet.weights import FC6
from sim.research.training.alexnet import LAYERS
from sim.research.training.images import LabeledImages
from sim.research.training.views import normalized, random_light, whole_view

BATCH = 64
MOST_RANGE_IMAGES = 2000


def top_shares(net: nn.Sequential, images: LabeledImages, device: str) -> tuple[float, float]:
    """Shares of pictures whose class is the most probable one, and among the five most probable ones."""
    best = min(5, len(images.classes))
    right = torch.zeros(best, device=device)
    with torch.inference_mode():
        for pixels, labels in _batches(images, len(images.labels), device):
            ranked = net(normalized(whole_view(pixels))).topk(best, dim=1).indices
            right += (ranked == labels[:, None]).sum(dim=0)
    shares = right.cumsum(0) / len(images.labels)
    return float(shares[0]), float(shares[-1])


def layer_ranges(net: nn.Sequential, images: LabeledImages, device: str, seed: int) -> dict[str, dict[str, float]]:
    """{layer: {min, max}} before ReLU, up to fc6, in random light: `lookback dev alexnet --ranges`."""
    torch.manual_seed(seed)
    names = LAYERS[: LAYERS.index(FC6) + 1]
    least, greatest = (torch.full((len(names),), value, device=device) for value in (torch.inf, -torch.inf))
    with torch.inference_mode():
        for pixels, _ in _batches(images, MOST_RANGE_IMAGES, device):
            outputs = list(_normed(net.trunk, normalized(random_light(whole_view(pixels)))))
            least = torch.minimum(least, torch.stack([output.min() for output in outputs]))
            greatest = torch.maximum(greatest, torch.stack([output.max() for output in outputs]))
    return {
        name: {"min": float(low), "max": float(high)} for name, low, high in zip(names, least, greatest, strict=True)
    }


def _normed(trunk: nn.Sequential, x: Tensor) -> Iterator[Tensor]:
    """Each layer's output after batch norm, which is that of the folded layer."""
    for module in trunk:
        x = module(x)
        if isinstance(module, nn.BatchNorm1d | nn.BatchNorm2d):
            yield x


def _batches(images: LabeledImages, most: int, device: str) -> Iterator[tuple[Tensor, Tensor]]:
    """Up to `most` pictures, evenly spread over the classes."""
    rows = torch.arange(0, len(images.labels), -(-len(images.labels) // most))
    for chosen in rows.split(BATCH):
        yield torch.from_numpy(images.pixels)[chosen].to(device), torch.from_numpy(images.labels)[chosen].to(device)
