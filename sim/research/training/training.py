"""Loss, schedule, averaged weights, and a loop that goes on from a checkpoint with the numbers it would have had."""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import msgspec
import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.optim.swa_utils import AveragedModel

from edge.errors import ConfigError
from edge.files import replacing
from sim.research.training.alexnet import alexnet
from sim.research.training.images import LabeledImages
from sim.research.training.recipe import Recipe
from sim.research.training.views import random_view

WARM_UP_EPOCHS = 2
Progress = Callable[[Iterable[int]], Iterable[int]]


class Training:
    """A network on its way. All that is random follows from the recipe's seed and the number of the step."""

    def __init__(self, images: LabeledImages, recipe: Recipe, device: str) -> None:
        """ConfigError if the images do not fill a batch."""
        if len(images.labels) < recipe.batch:
            raise ConfigError(f"--batch: {recipe.batch} pictures a step, but there are {len(images.labels)} in all")
        self.recipe, self.device, self.step = recipe, device, 0
        self._images = images
        self._pixels, self._labels = torch.from_numpy(images.pixels), torch.from_numpy(images.labels)
        self.steps_per_epoch = len(images.labels) // recipe.batch
        torch.manual_seed(recipe.seed)
        self._net = alexnet(len(images.classes)).to(device, memory_format=torch.channels_last)
        # Batch norm's statistics are not averaged but taken over, as `AveragedModel` does on its own.
        self._average = AveragedModel(self._net, multi_avg_fn=self._take_average)
        self._optimizer = _optimizer(self._net, recipe)

    @property
    def epoch(self) -> int:
        """Whole epochs that are done."""
        return self.step // self.steps_per_epoch

    def averaged(self) -> nn.Sequential:
        """The network with averaged weights, in evaluation."""
        net: nn.Sequential = self._average.module
        return net.eval()

    def run_epoch(self, progress: Progress = iter) -> float:
        """Train to the end of the epoch and return its mean loss; ConfigError if that is not finite."""
        recipe, epoch = self.recipe, self.epoch
        shuffled = torch.randperm(len(self._labels), generator=torch.Generator().manual_seed(recipe.seed + epoch))
        total = torch.zeros((), device=self.device)
        for number in progress(range(self.steps_per_epoch)):
            total += self._train(shuffled[number * recipe.batch :][: recipe.batch])
        loss = float(total) / self.steps_per_epoch
        if not math.isfinite(loss):
            raise ConfigError(f"--rate: the loss of epoch {epoch + 1} is {loss}; try less than {recipe.peak_rate:g}")
        return loss

    def _train(self, chosen: Tensor) -> Tensor:
        """One step with two views of the chosen pictures; returns its loss."""
        torch.manual_seed((self.recipe.seed << 32) + self.step)
        for group in self._optimizer.param_groups:
            group["lr"] = learning_rate(self.recipe, self.step, self.steps_per_epoch)
        pixels, labels = self._pixels[chosen].to(self.device), self._labels[chosen].to(self.device)
        views = torch.cat([random_view(pixels), random_view(pixels)]).contiguous(memory_format=torch.channels_last)
        self._net.train()
        with torch.autocast(self.device, torch.bfloat16, enabled=self.device != "cpu"):
            fc6 = self._net.trunk(views)
            logits = self._net.head(fc6)
        loss = two_view_loss(fc6.float(), logits.float(), labels, self.recipe)
        self._optimizer.zero_grad(set_to_none=True)
        loss.backward()
        nn.utils.clip_grad_norm_(self._net.parameters(), self.recipe.longest_gradient)
        self._optimizer.step()
        self._average.update_parameters(self._net)
        self.step += 1
        return loss.detach()

    def _take_average(self, averaged: list[Tensor], current: list[Tensor], count: Tensor | int) -> None:
        """Young averages forget sooner, or the random weights of the beginning would stay in them."""
        decay = min(self.recipe.average, (int(count) + 1) / (int(count) + 10))
        torch._foreach_lerp_(averaged, current, 1 - decay)

    def save(self, file: Path) -> None:
        """Write a checkpoint in one step; ConfigError if it cannot be written."""
        try:
            with replacing(file) as stream:
                torch.save({"of": self._identity(), "step": self.step, **self._states()}, stream)
        except (OSError, RuntimeError) as error:
            raise ConfigError(f"{file}: cannot write the checkpoint: {str(error).splitlines()[0]}") from None

    def go_on_from(self, file: Path) -> None:
        """Take the place of the training that wrote a checkpoint; ConfigError if it was another one, or is damaged."""
        try:
            found = torch.load(file, map_location=self.device, weights_only=True)
            if found["of"] != self._identity():
                raise ConfigError(f"{file}: of a training with other settings or pictures; remove it to begin anew")
            self._net.load_state_dict(found["net"])
            self._average.load_state_dict(found["average"])
            self._optimizer.load_state_dict(found["optimizer"])
            self.step = int(found["step"])
        except (OSError, RuntimeError, pickle.UnpicklingError, EOFError, KeyError, TypeError, ValueError):
            raise ConfigError(f"{file}: not a whole checkpoint; remove it to begin anew") from None

    def _identity(self) -> dict[str, Any]:
        """What must be the same for the steps that are left to be the same."""
        shape = list(self._images.pixels.shape)
        return {**msgspec.structs.asdict(self.recipe), "images": shape, "classes": list(self._images.classes)}

    def _states(self) -> dict[str, Any]:
        parts = {"net": self._net, "average": self._average, "optimizer": self._optimizer}
        return {name: part.state_dict() for name, part in parts.items()}


def learning_rate(recipe: Recipe, step: int, steps_per_epoch: int) -> float:
    """Half a cosine from the peak to 0, and linearly up to it in the first two epochs."""
    warm_up = min(1.0, (step + 1) / (WARM_UP_EPOCHS * steps_per_epoch))
    return recipe.peak_rate * warm_up * 0.5 * (1 + math.cos(math.pi * step / (recipe.epochs * steps_per_epoch)))


def two_view_loss(fc6: Tensor, logits: Tensor, labels: Tensor, recipe: Recipe) -> Tensor:
    """Cross-entropy of the categories, and of finding each picture's other view in the batch by its fc6.

    fc6 (2B, 4096) before ReLU, logits (2B, C): of the one view of all pictures, then of the other. labels (B,).
    """
    count = len(labels)
    category = functional.cross_entropy(logits, torch.cat([labels, labels]), label_smoothing=recipe.label_smoothing)
    directions = functional.normalize(fc6, dim=1)
    alike = directions[:count] @ directions[count:].T / recipe.temperature
    same = torch.arange(count, device=labels.device)
    found = functional.cross_entropy(alike, same) + functional.cross_entropy(alike.T, same)
    return category + recipe.contrast * 0.5 * found


def _optimizer(net: nn.Module, recipe: Recipe) -> torch.optim.Optimizer:
    """Biases and batch norm do not decay."""
    matrices, rest = ([p for p in net.parameters() if (p.ndim > 1) == wide] for wide in (True, False))
    return torch.optim.SGD(
        [{"params": matrices, "weight_decay": recipe.weight_decay}, {"params": rest, "weight_decay": 0.0}],
        lr=recipe.peak_rate,
        momentum=recipe.momentum,
        nesterov=True,
    )
