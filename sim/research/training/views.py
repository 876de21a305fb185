"""Random views of pictures: what changes when a place is seen again from elsewhere, and in other light.

All take and return batches (N, 3, H, W) float32 RGB, 0 to 1, on any device, and draw from PyTorch's own generator.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn import functional

from sim.model_tools.onnx_graph import MEAN_RGB, STD_RGB
from sim.research.alexnet.graph import INPUT_SIZE

LEAST_AREA = 0.25
MIRRORED, GRAY, BLURRED, NOISY = 0.5, 0.15, 0.35, 0.5  # shares of the pictures
EXPOSURE_LOG = (-1.3, 0.4)
GAMMA_LOG, CONTRAST_LOG, SATURATION_LOG = (-0.6, 0.6), (-0.5, 0.5), (-1.0, 0.4)
CAST_DEVIATION = 0.15  # of each channel's log gain
MOST_NOISE = 0.07
DARKEST = 1e-4  # a power has no slope at 0


def random_view(pixels: Tensor) -> Tensor:
    """Pictures (N, side, side, 3) uint8 RGB -> what the network takes, (N, 3, 224, 224) float32, normalized."""
    return normalized(random_light(random_resized_crop(pixels.permute(0, 3, 1, 2).float() / 255)))


def whole_view(pixels: Tensor) -> Tensor:
    """The whole of pictures (N, side, side, 3) uint8, (N, 3, 224, 224) float32, 0 to 1."""
    return functional.interpolate(
        pixels.permute(0, 3, 1, 2).float() / 255, (INPUT_SIZE, INPUT_SIZE), mode="bilinear", antialias=True
    )


def normalized(images: Tensor) -> Tensor:
    """Less ImageNet's mean, over its deviation."""
    mean, std = (torch.tensor(values, device=images.device).view(1, 3, 1, 1) for values in (MEAN_RGB, STD_RGB))
    return (images - mean) / std


def random_resized_crop(images: Tensor) -> Tensor:
    """A quarter to all of the area, sides 3:4 to 4:3, resized to the network's input, half of them mirrored."""
    count = len(images)
    area = torch.empty(count, device=images.device).uniform_(LEAST_AREA, 1)
    ratio = torch.empty(count, device=images.device).uniform_(math.log(3 / 4), math.log(4 / 3)).exp()
    width, height = (area * ratio).sqrt().clamp(max=1), (area / ratio).sqrt().clamp(max=1)
    # Half widths and centers in affine_grid's coordinates, in which a picture spans -1 to 1.
    affine = torch.zeros(count, 2, 3, device=images.device)
    affine[:, 0, 0] = torch.where(_happens(images, MIRRORED).flatten(), -width, width)
    affine[:, 1, 1] = height
    affine[:, 0, 2] = _uniform(images, -1, 1).flatten() * (1 - width)
    affine[:, 1, 2] = _uniform(images, -1, 1).flatten() * (1 - height)
    grid = functional.affine_grid(affine, [count, 3, INPUT_SIZE, INPUT_SIZE], align_corners=False)
    return functional.grid_sample(images, grid, padding_mode="reflection", align_corners=False)


def random_light(images: Tensor) -> Tensor:
    """Gamma and exposure, contrast, saturation down to gray, a cast of color, blur, and the sensor's noise."""
    light = (images.clamp(0, 1) + DARKEST) ** _uniform(images, *GAMMA_LOG).exp() * _uniform(images, *EXPOSURE_LOG).exp()
    mean = light.mean((1, 2, 3), keepdim=True)
    light = mean + (light - mean) * _uniform(images, *CONTRAST_LOG).exp()
    gray = light.mean(1, keepdim=True)
    light = gray + (light - gray) * _uniform(images, *SATURATION_LOG).exp() * ~_happens(images, GRAY)
    light = light * (torch.randn(len(images), 3, 1, 1, device=images.device) * CAST_DEVIATION).exp()
    light = torch.where(_happens(images, BLURRED), _blurred(light), light)
    noise = torch.randn_like(light) * _uniform(images, 0, MOST_NOISE) * _happens(images, NOISY)
    return (light + noise).clamp(0, 1)


def _blurred(images: Tensor) -> Tensor:
    row = torch.tensor([1.0, 4, 6, 4, 1], device=images.device) / 16
    kernels = torch.outer(row, row).expand(3, 1, 5, 5)
    return functional.conv2d(functional.pad(images, (2, 2, 2, 2), mode="reflect"), kernels, groups=3)


def _uniform(images: Tensor, low: float, high: float) -> Tensor:
    """A number for each picture, (N, 1, 1, 1)."""
    return torch.empty(len(images), 1, 1, 1, device=images.device).uniform_(low, high)


def _happens(images: Tensor, share: float) -> Tensor:
    """True for a share of the pictures, (N, 1, 1, 1)."""
    return torch.rand(len(images), 1, 1, 1, device=images.device) < share
