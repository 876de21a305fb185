"""A few steps of training on generated pictures: what is learned, folded, saved, and made int8."""

# What trains cannot be imported without PyTorch.
# ruff: noqa: E402

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="training needs the extra `torch`")

from edge.errors import ConfigError, ModelError
from sim.research.training.alexnet import alexnet, fold, save_weights
from sim.research.training.images import LabeledImages, find_classes, read_images
from sim.research.training.measure import layer_ranges, top_shares
from sim.research.training.recipe import Recipe
from sim.research.training.training import Training, learning_rate, two_view_loss
from sim.research.training.views import normalized, random_light, random_resized_crop, random_view, whole_view

RECIPE = Recipe(epochs=2, batch=6, peak_rate=0.02)


@pytest.fixture
def images(write_classes: Any) -> LabeledImages:
    return read_images(find_classes(write_classes(2)), 64, iter)


def _images(count: int) -> Any:
    return torch.rand(count, 3, 48, 48, generator=torch.Generator().manual_seed(1))


def test_the_loss_falls_and_the_classes_are_told_apart(write_classes: Any) -> None:
    images = read_images(find_classes(write_classes(4)), 64, iter)
    training = Training(images, Recipe(epochs=8, batch=12, peak_rate=0.02), "cpu")
    losses = [training.run_epoch() for _ in range(8)]
    assert np.mean(losses[-3:]) < 0.85 * np.mean(losses[:3]), losses
    assert top_shares(training.averaged(), images, "cpu")[0] > 0.9


def test_training_goes_on_from_a_checkpoint_with_the_same_numbers(images: LabeledImages, tmp_path: Path) -> None:
    whole = Training(images, RECIPE, "cpu")
    losses = [whole.run_epoch(), whole.run_epoch()]
    cut_off = Training(images, RECIPE, "cpu")
    assert cut_off.run_epoch() == losses[0]
    cut_off.save(tmp_path / "c")
    torch.rand(3)  # whatever else draws from the generator in between
    resumed = Training(images, RECIPE, "cpu")
    resumed.go_on_from(tmp_path / "c")
    assert resumed.epoch == 1 and resumed.run_epoch() == losses[1]
    expected, found = whole.averaged().state_dict(), resumed.averaged().state_dict()
    assert all(torch.equal(expected[name], found[name]) for name in expected)


def test_another_trainings_checkpoint_and_a_damaged_one_are_refused(images: LabeledImages, tmp_path: Path) -> None:
    file = tmp_path / "w.checkpoint"
    Training(images, RECIPE, "cpu").save(file)
    other = Training(images, msgspec.structs.replace(RECIPE, epochs=9), "cpu")
    with pytest.raises(ConfigError, match=r"w\.checkpoint: of a training with other settings or pictures; remove it"):
        other.go_on_from(file)
    file.write_bytes(file.read_bytes()[:1000])
    with pytest.raises(ConfigError, match=r"w\.checkpoint: not a whole checkpoint; remove it"):
        other.go_on_from(file)


def test_a_rate_that_is_too_high_is_told(images: LabeledImages) -> None:
    training = Training(images, msgspec.structs.replace(RECIPE, batch=3, peak_rate=1e30), "cpu")
    with pytest.raises(ConfigError, match=r"--rate: the loss of epoch 1 is (nan|inf); try less than 1e\+30"):
        training.run_epoch()


def test_folding_leaves_the_outputs_as_they_are(torchvision_alexnet: Any) -> None:
    torch.manual_seed(2)
    net = alexnet(classes=3)
    net(normalized(random_resized_crop(_images(6))))  # statistics and scales as training leaves them: not 0 and 1
    for module in net.modules():
        if isinstance(module, torch.nn.BatchNorm1d | torch.nn.BatchNorm2d):
            torch.nn.init.uniform_(module.weight, 0.5, 1.5)
            torch.nn.init.uniform_(module.bias, -0.5, 0.5)
    plain = torchvision_alexnet(1024, 3)
    plain.load_state_dict({name: torch.from_numpy(array) for name, array in fold(net).items()}, strict=True)
    views = normalized(random_resized_crop(_images(5)))
    with torch.inference_mode():
        np.testing.assert_allclose(plain(views), net.eval()(views), rtol=1e-4, atol=1e-4)
        np.testing.assert_allclose(plain[:2](views).shape, (5, 9216))


def test_ranges_are_those_of_the_folded_layers(images: LabeledImages, torchvision_alexnet: Any) -> None:
    net = Training(images, RECIPE, "cpu").averaged()
    plain = torchvision_alexnet(1024, 3)
    plain.load_state_dict({name: torch.from_numpy(array) for name, array in fold(net).items()})
    found = layer_ranges(net, images, "cpu", seed=3)
    outputs: dict[str, tuple[float, float]] = {}
    for name in found:
        plain.get_submodule(name).register_forward_hook(
            lambda _, __, output, name=name: outputs.update({name: (float(output.min()), float(output.max()))})
        )
    torch.manual_seed(3)
    with torch.inference_mode():
        plain(normalized(random_light(whole_view(torch.from_numpy(images.pixels)))))
    for name, (least, greatest) in outputs.items():
        assert found[name] == pytest.approx({"min": least, "max": greatest}, rel=1e-3), name
    assert list(found)[-1] == "classifier.1" and len(found) == 6


def test_weights_too_large_for_float16_are_refused(tmp_path: Path) -> None:
    weights = fold(alexnet(classes=2))
    weights["features.3.weight"] = weights["features.3.weight"] * 1e7
    with pytest.raises(ModelError, match=r"features\.3\.weight has values that are not finite"):
        save_weights(weights, tmp_path / "w.npz")
    assert not (tmp_path / "w.npz").exists()


def test_the_schedule_rises_for_two_epochs_and_ends_at_nothing() -> None:
    recipe = Recipe(epochs=10, peak_rate=0.4)
    rates = [learning_rate(recipe, step, steps_per_epoch=5) for step in range(50)]
    assert rates[0] == pytest.approx(0.04, rel=0.01)
    assert max(rates) == rates[9] == pytest.approx(0.4 * 0.5 * (1 + np.cos(np.pi * 9 / 50)))
    assert all(later < earlier for earlier, later in pairwise(rates[9:]))
    assert rates[-1] < 0.001


def test_the_loss_is_the_cross_entropy_of_classes_and_of_finding_the_other_view() -> None:
    rng = np.random.default_rng(4)
    fc6, logits, labels = rng.normal(size=(6, 20)), rng.normal(size=(6, 3)), np.array([0, 2, 1])

    def cross_entropy(scores: Any, rights: Any, smoothing: float = 0.0) -> float:
        logs = scores - np.log(np.exp(scores).sum(axis=1, keepdims=True))
        return float(
            np.mean([-(1 - smoothing) * logs[i, r] - smoothing * logs[i].mean() for i, r in enumerate(rights)])
        )

    units = fc6 / np.linalg.norm(fc6, axis=1, keepdims=True)
    alike = units[:3] @ units[3:].T / 0.1
    found = cross_entropy(alike, range(3)) + cross_entropy(alike.T, range(3))
    expected = cross_entropy(logits, [0, 2, 1, 0, 2, 1], 0.1) + 0.3 * 0.5 * found
    loss = two_view_loss(torch.from_numpy(fc6), torch.from_numpy(logits), torch.from_numpy(labels), Recipe())
    assert float(loss) == pytest.approx(expected, rel=1e-6)


def test_views_differ_and_stay_pictures() -> None:
    torch.manual_seed(6)
    pixels = (_images(64).permute(0, 2, 3, 1) * 255).byte()
    first, second = random_view(pixels), random_view(pixels)
    assert first.shape == (64, 3, 224, 224) and not torch.allclose(first, second)
    light = random_light(_images(64))
    assert float(light.min()) >= 0 and float(light.max()) <= 1
    means = light.mean((1, 2, 3))
    assert float(means.max() / means.min()) > 3  # exposures from e^-1.3 to e^0.4


def test_crops_are_parts_of_the_picture_and_half_of_them_mirrored() -> None:
    torch.manual_seed(7)
    ramp = torch.linspace(0, 1, 64).expand(400, 3, 64, 64)  # brighter to the right
    crops = random_resized_crop(ramp)
    left, right = crops[:, 0, 112, 1], crops[:, 0, 112, -2]
    assert 0.4 < float((left > right).float().mean()) < 0.6
    widths = (left - right).abs()
    assert float(widths.min()) > 0.42 and float(widths.max()) <= 1  # sqrt(1/4 * 3/4) = 0.433 at the least
