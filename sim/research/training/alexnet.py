"""torchvision's AlexNet with batch norm after every layer but the last, which is folded into the weights afterwards."""

from __future__ import annotations

from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import nn
from torch.nn.utils.fusion import fuse_conv_bn_eval, fuse_linear_bn_eval

from edge.errors import ModelError
from sim.research.alexnet.weights import CONVS, FC6, FC6_SHAPE, read_weights

FC7, FC8 = "classifier.4", "classifier.6"
FC7_WIDTH = 1024
LAYERS = (*(conv.layer for conv in CONVS), FC6, FC7, FC8)


def alexnet(classes: int) -> nn.Sequential:
    """`trunk`: images (N, 3, 224, 224) to fc6 before its ReLU (N, 4096); `head`: that to logits (N, classes).

    Batch norm makes fc6 NSD over the batch. Weights are drawn from PyTorch's generator.
    """
    width = FC6_SHAPE[0]
    trunk = [
        *(module for conv in CONVS for module in _conv_block(conv.shape, conv.stride, conv.pad, conv.pool)),
        nn.Flatten(),
        nn.Dropout(0.2),
        *_dense(FC6_SHAPE[1], width),
    ]
    last = nn.Linear(FC7_WIDTH, classes)
    nn.init.normal_(last.weight, 0, FC7_WIDTH**-0.5)
    nn.init.zeros_(last.bias)
    head = [nn.ReLU(), nn.Dropout(0.5), *_dense(width, FC7_WIDTH), nn.ReLU(), nn.Dropout(0.3), last]
    return nn.Sequential(OrderedDict(trunk=nn.Sequential(*trunk), head=nn.Sequential(*head)))


def _conv_block(shape: tuple[int, int, int, int], stride: int, pad: int, pool: bool) -> list[nn.Module]:
    out, given, kernel, _ = shape
    conv = nn.Conv2d(given, out, kernel, stride, pad, bias=False)
    nn.init.kaiming_normal_(conv.weight, mode="fan_out", nonlinearity="relu")
    return [conv, nn.BatchNorm2d(out), nn.ReLU(), *([nn.MaxPool2d(3, 2)] if pool else [])]


def _dense(given: int, out: int) -> list[nn.Module]:
    dense = nn.Linear(given, out, bias=False)
    nn.init.normal_(dense.weight, 0, given**-0.5)
    return [dense, nn.BatchNorm1d(out)]


def fold(net: nn.Sequential) -> dict[str, NDArray[np.float32]]:
    """The weights of the same function without batch norm, in evaluation, by torchvision's names."""
    layers = [m for m in net.modules() if isinstance(m, nn.Conv2d | nn.Linear)]
    norms = [m for m in net.modules() if isinstance(m, nn.BatchNorm1d | nn.BatchNorm2d)]
    folded: list[nn.Module] = []
    for layer, norm in zip(layers, norms, strict=False):
        fuse = fuse_conv_bn_eval if isinstance(layer, nn.Conv2d) else fuse_linear_bn_eval
        folded.append(fuse(layer.eval(), norm.eval()))
    weights = {}
    for name, layer in zip(LAYERS, [*folded, layers[-1]], strict=True):
        for part in ("weight", "bias"):
            weights[f"{name}.{part}"] = getattr(layer, part).detach().float().cpu().numpy()
    return weights


def save_weights(weights: dict[str, NDArray[np.float32]], file: Path) -> None:
    """Write an .npz for `lookback dev alexnet`: matrices float16, biases float32. ModelError names the file."""
    with np.errstate(over="ignore"):  # becomes infinite, and is found below
        halved: dict[str, Any] = {
            name: array.astype(np.float16) if array.ndim > 1 else array for name, array in weights.items()
        }
    part = file.with_suffix(".part.npz")
    try:
        np.savez(part, **halved)
        read_weights(part)  # finite, and in AlexNet's shapes
        part.replace(file)
    except OSError as error:
        raise ModelError(f"{file}: cannot write the weights: {error.strerror}") from None
    finally:
        part.unlink(missing_ok=True)
