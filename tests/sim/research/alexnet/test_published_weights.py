"""A file shaped as the published alexnet_places365.pth.tar becomes an int8 network that agrees with PyTorch's float."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from edge.__main__ import main
from edge.descriptor.network import Network, cut_regions
from edge.descriptor.open_network import cosines, nsd_cosines
from edge.feed import Feed, FeedImages, read_feed
from sim.model_tools.onnx_graph import MEAN_RGB, STD_RGB
from sim.research.alexnet.weights import read_weights
from tests.descriptor.accuracy import matching_accuracy

torch: Any = pytest.importorskip("torch", reason="needs the extra `torch`")
pytest.importorskip("onnx", reason="importing models needs the extra `model`")

FC7_WIDTH, CLASSES = 4096, 365
Arrays = dict[str, NDArray[Any]]
Build = Callable[[int, int], Any]


def write_checkpoint(arrays: Arrays, file: Path) -> Path:
    """As the authors of Places365 saved theirs: DataParallel around the convolutions, other things beside the state."""
    state = {name.replace("features.", "features.module."): torch.from_numpy(array) for name, array in arrays.items()}
    torch.save({"epoch": 90, "arch": "alexnet", "state_dict": state, "best_prec1": torch.tensor(53.2)}, file)
    return file


def widened(weights: Any) -> Arrays:
    """Trained weights in the published shape: more units in fc7 that nothing enters or leaves, and unlikely classes."""
    arrays: Arrays = dict(weights)
    fc7, fc8 = arrays["classifier.4.weight"], arrays["classifier.6.weight"]
    more = (FC7_WIDTH - len(fc7), CLASSES - len(fc8))
    arrays["classifier.4.weight"] = np.pad(fc7, ((0, more[0]), (0, 0)))
    arrays["classifier.4.bias"] = np.pad(arrays["classifier.4.bias"], (0, more[0]))
    arrays["classifier.6.weight"] = np.pad(fc8, ((0, more[1]), (0, more[0])))
    arrays["classifier.6.bias"] = np.pad(arrays["classifier.6.bias"], (0, more[1]), constant_values=-30)
    return arrays


@pytest.fixture
def torch_network(torchvision_alexnet: Build) -> Callable[[Path], Any]:
    """PyTorch's own float network of a checkpoint, all of whose weights must fit by name and shape."""

    def load(file: Path) -> Any:
        net = torchvision_alexnet(FC7_WIDTH, CLASSES)
        state = torch.load(file, weights_only=True)["state_dict"]
        net.load_state_dict({name.replace("module.", ""): value for name, value in state.items()}, strict=True)
        return net

    return load


def float_fc6(net: Any, images: NDArray[np.uint8]) -> NDArray[np.float32]:
    """fc6 after ReLU (R, 4096) of images (R, 224, 224, 3) uint8 BGR, prepared as torchvision prepares them."""
    rgb = images[..., ::-1].astype(np.float32) / 255
    prepared = (rgb - np.array(MEAN_RGB, np.float32)) / np.array(STD_RGB, np.float32)
    with torch.inference_mode():
        convolved = net.flatten(net.features(torch.from_numpy(prepared.transpose(0, 3, 1, 2).copy())))
        return np.asarray(net.classifier[:3](convolved))


def described(feed: Feed, describe: Callable[[NDArray[np.uint8]], NDArray[np.float32]]) -> NDArray[np.float32]:
    """Raw descriptors (N, 1, 4096) of all whole frames."""
    images = FeedImages(feed)
    found = np.stack(
        [describe(cut_regions(images.read(row), "whole", 0.4, (224, 224))) for row in range(len(feed.rows))]
    )
    images.close()
    return found


def test_trained_weights_in_the_published_shape(
    shared: Path, tmp_path: Path, torch_network: Callable[[Path], Any]
) -> None:
    weights, _ = read_weights(shared / "model/alexnet_places100_fp16.npz")
    file = write_checkpoint(widened(weights), tmp_path / "alexnet_places365.pth.tar")
    ranges = shared / "model/activation_ranges.json"
    assert main(["dev", "alexnet", str(file), "-o", str(tmp_path / "model"), "--ranges", str(ranges)]) == 0
    network, exact = Network.load(tmp_path / "model"), torch_network(file)
    feeds = [read_feed(shared / "feeds" / name) for name in ("corridor_query", "corridor_reference")]
    rows = np.arange(len(feeds[0].rows))
    right = np.abs(rows[:, None] - np.arange(len(feeds[1].rows))) <= 3
    int8 = [described(feed, network.describe) for feed in feeds]
    floats = [described(feed, lambda images: float_fc6(exact, images)) for feed in feeds]
    for given, rounded in zip(floats, int8, strict=True):
        assert nsd_cosines(given, rounded).mean() >= 0.99
    share = matching_accuracy(floats[0], floats[1], right)
    assert share > 0.8  # or agreeing would mean little
    assert matching_accuracy(int8[0], int8[1], right) == pytest.approx(share, abs=0.01)


def test_random_weights_in_the_published_shape(
    published_weights: Path, tmp_path: Path, torch_network: Callable[[Path], Any], write_traverse: Any
) -> None:
    arrays = read_weights(published_weights)[0]
    file = write_checkpoint(dict(arrays), tmp_path / "alexnet_places365.pth.tar")
    feed = write_traverse(tmp_path / "street", range(8))
    assert main(["dev", "alexnet", str(file), "-o", str(tmp_path / "model"), "--calibrate", str(feed)]) == 0
    network = Network.load(tmp_path / "model")
    assert network.info.name == "alexnet_places365"
    int8, exact = network.describe, torch_network(file)
    floats = described(read_feed(feed), lambda images: float_fc6(exact, images))
    assert cosines(floats, described(read_feed(feed), int8)).mean() > 0.999
