"""AlexNet as PyTorch builds it."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import Any

import pytest


@pytest.fixture
def torchvision_alexnet() -> Callable[[int, int], Any]:
    """Builds AlexNet in PyTorch as torchvision does, names of the weights included: (width of fc7, classes) -> module.

    torchvision.models.alexnet has an adaptive pool as well, which changes nothing at 224x224.
    """
    torch = pytest.importorskip("torch", reason="needs the extra `torch`")
    nn = torch.nn

    def build(hidden: int, classes: int) -> Any:
        features = nn.Sequential(
            *(nn.Conv2d(3, 64, 11, 4, 2), nn.ReLU(), nn.MaxPool2d(3, 2)),
            *(nn.Conv2d(64, 192, 5, 1, 2), nn.ReLU(), nn.MaxPool2d(3, 2)),
            *(nn.Conv2d(192, 384, 3, 1, 1), nn.ReLU()),
            *(nn.Conv2d(384, 256, 3, 1, 1), nn.ReLU()),
            *(nn.Conv2d(256, 256, 3, 1, 1), nn.ReLU(), nn.MaxPool2d(3, 2)),
        )
        classifier = nn.Sequential(
            *(nn.Dropout(), nn.Linear(9216, 4096), nn.ReLU()),
            *(nn.Dropout(), nn.Linear(4096, hidden), nn.ReLU(), nn.Linear(hidden, classes)),
        )
        parts = OrderedDict(features=features, flatten=nn.Flatten(), classifier=classifier)
        return nn.Sequential(parts).eval()

    return build
