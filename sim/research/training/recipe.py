"""How to train, as the shipped network was trained. Without PyTorch, so that the options can be read without it."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct


class Recipe(Struct, frozen=True, forbid_unknown_fields=True):
    """SGD with momentum, a cosine schedule after two epochs of warm-up, and averaged weights.

    batch: pictures a step, of each of which two views are taken. contrast: weight of the contrastive term.
    temperature: over which its cosines are divided. average: decay of the averaged weights, once they have settled.
    """

    epochs: Annotated[int, Meta(ge=1)] = 58
    batch: Annotated[int, Meta(ge=2)] = 512
    peak_rate: Annotated[float, Meta(gt=0)] = 0.1
    contrast: Annotated[float, Meta(ge=0)] = 0.3
    seed: Annotated[int, Meta(ge=0, lt=2**31)] = 0
    momentum: float = 0.9
    weight_decay: float = 5e-4
    label_smoothing: float = 0.1
    temperature: float = 0.1
    average: float = 0.9995
    longest_gradient: float = 5.0
