"""Fixtures that several folders of tests need."""

from __future__ import annotations

import os
import struct
from collections import OrderedDict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import settings
from numpy.typing import NDArray

from edge.commands.map_build import build_map
from edge.config import DescriptorConfig, SamplingConfig
from edge.descriptor.model_file import ModelInfo
from edge.feed import FeedHeader, FeedWriter, read_feed
from sim.evaluation.memoizing_network import MemoizingNetwork
from sim.model_tools.onnx_graph import DIMENSIONS, MEAN_RGB, PAD_LEVEL, STD_RGB
from sim.model_tools.weights import CONVS, FC6_SHAPE, Weights

settings.register_profile("repeatable", derandomize=True, database=None, deadline=None)
settings.load_profile("repeatable")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """Workers of `-n auto`: tests wait for processes and clocks more than they compute."""
    return max(4, 2 * (os.cpu_count() or 1))


SHARED = Path(__file__).parents[2] / "shared"


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of real recordings and float weights beside the checkout; what needs it is skipped without it."""
    if not SHARED.is_dir():
        pytest.skip(f"needs the real recordings in {SHARED.name}/ beside the checkout, which is not there")
    return SHARED


@pytest.fixture(scope="session")
def read_tlog(shared: Path) -> Callable[[str], Iterator[tuple[int, bytes]]]:
    """Yields (arrival in ns, one MAVLink 2 frame) of a real autopilot's recording, named without its suffix."""

    def read(name: str) -> Iterator[tuple[int, bytes]]:
        data = (shared / "autopilot" / f"{name}.tlog").read_bytes()
        at = 0
        while at + 20 <= len(data):
            (stamp_us,) = struct.unpack_from(">Q", data, at)
            size = 12 + data[at + 9] + 13 * (data[at + 10] & 1)
            yield stamp_us * 1000, data[at + 8 : at + 8 + size]
            at += 8 + size

    return read


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


def _street(length_px: int) -> np.ndarray:
    """A long strip of colored fronts with windows: every stretch of it looks like no other."""
    rng = np.random.default_rng(7)
    strip = np.full((120, length_px, 3), 200, dtype=np.uint8)
    at = 0
    while at < length_px:
        width, top = int(rng.integers(40, 110)), int(rng.integers(10, 70))
        cv2.rectangle(strip, (at, top), (at + width, 119), rng.integers(20, 235, 3).tolist(), -1)
        for _ in range(int(rng.integers(1, 7))):
            x, y = at + int(rng.integers(0, width)), int(rng.integers(top, 110))
            cv2.rectangle(strip, (x, y), (x + int(rng.integers(5, 25)), y + 12), rng.integers(0, 255, 3).tolist(), -1)
        at += width
    return strip


@pytest.fixture(scope="session")
def write_traverse() -> Callable[..., Path]:
    """Writes a feed that passes the fronts of one and the same street, 2 m and `period_ms` a frame."""
    strip = _street(160 + 12 * 80)

    def write(path: Path, frames: range = range(80), *, noise: float = 0.0, period_ms: int = 50) -> Path:
        rng = np.random.default_rng(1)
        with FeedWriter(path, FeedHeader(path.name, "front", 160, 120)) as writer:
            for row, frame in enumerate(frames):
                image = strip[:, 12 * frame : 12 * frame + 160] + rng.normal(0, noise, (120, 160, 3))
                writer.write(
                    image.clip(0, 255).astype(np.uint8),
                    row * period_ms * 1_000_000,
                    lat_deg=-27.0 + frame * 2 / 110_800,
                    lon_deg=153.0,
                    heading_deg=0.0,
                    distance_m=row * 2.0,
                )
        return path

    return write


@pytest.fixture(scope="session")
def network() -> MemoizingNetwork:
    """The shipped network for all tests that do not test the network itself: it describes each picture once."""
    return MemoizingNetwork.load()


@pytest.fixture(scope="session")
def make_street(
    network: MemoizingNetwork, write_traverse: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory
) -> Callable[..., Path]:
    """Makes a folder with the `feed` of a drive along the street, and the `map` made of it."""

    def make(frames: range = range(80), *, period_ms: int = 50, sampling: SamplingConfig | None = None) -> Path:
        folder = tmp_path_factory.mktemp("street")
        feed = read_feed(write_traverse(folder / "feed", frames, period_ms=period_ms))
        build_map([feed], folder / "map", DescriptorConfig(), sampling or SamplingConfig(), network=network)
        return folder

    return make


Oracle = Callable[..., dict[str, NDArray[np.float64]]]


def random_weights(hidden: int, classes: int) -> dict[str, NDArray[np.float16]]:
    """Kaiming-normal weights: activations keep their size through the layers, as in a trained network."""
    random = np.random.default_rng(7)
    shapes = {conv.layer: conv.shape for conv in CONVS}
    shapes |= {"classifier.1": FC6_SHAPE, "classifier.4": (hidden, 4096), "classifier.6": (classes, hidden)}
    weights = {}
    for layer, shape in shapes.items():
        deviation = np.float32(2 / np.prod(shape[1:])) ** 0.5
        weights[f"{layer}.weight"] = (random.standard_normal(shape, np.float32) * deviation).astype(np.float16)
        weights[f"{layer}.bias"] = (random.standard_normal(shape[0], np.float32) * 0.1).astype(np.float16)
    return weights


@pytest.fixture(scope="session")
def published_weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file in the published network's shape (fc7 4096 wide, 365 classes) and with its names (DataParallel)."""
    file = tmp_path_factory.mktemp("weights") / "alexnet_places365.npz"
    weights = random_weights(hidden=4096, classes=365)
    np.savez(file, **{name.replace("features.", "features.module."): value for name, value in weights.items()})
    return file


@pytest.fixture
def info() -> ModelInfo:
    """What a float network of random weights says of itself."""
    return ModelInfo(
        name="random",
        tap="fc6",
        dimensions=DIMENSIONS["fc6"],
        precision="float32",
        input_size=224,
        channel_order="BGR",
        mean_rgb=MEAN_RGB,
        std_rgb=STD_RGB,
        labels=(),
        licence="none",
        source="random numbers",
        weights_sha256="",
        calibration="",
    )


@pytest.fixture(scope="session")
def alexnet() -> Oracle:
    """AlexNet in float64, layer by layer as the paper draws it; no code of the importer."""
    return _alexnet


def _alexnet(
    weights: Weights, image_bgr: NDArray[np.uint8], pad_level: float | NDArray[np.float64] = PAD_LEVEL
) -> dict[str, NDArray[np.float64]]:
    """conv3, fc6 and categories of one image (224, 224, 3) BGR; conv1 sees `pad_level` (RGB) around it."""
    padded = np.full((228, 228, 3), pad_level, dtype=np.float64)
    padded[2:-2, 2:-2] = image_bgr[..., ::-1]
    layers: dict[str, NDArray[np.float64]] = {}
    x = ((padded / 255 - MEAN_RGB) / STD_RGB).transpose(2, 0, 1)
    x = _pool(_conv(weights, "features.0", x, stride=4, pad=0))
    x = _pool(_conv(weights, "features.3", x, stride=1, pad=2))
    layers["conv3"] = x = _conv(weights, "features.6", x, stride=1, pad=1)
    x = _conv(weights, "features.8", x, stride=1, pad=1)
    x = _pool(_conv(weights, "features.10", x, stride=1, pad=1))
    layers["fc6"] = x = np.maximum(_dense(weights, "classifier.1", x.ravel()), 0)
    if "classifier.4.weight" in weights:
        x = _dense(weights, "classifier.6", np.maximum(_dense(weights, "classifier.4", x), 0))
        layers["categories"] = np.exp(x - x.max()) / np.exp(x - x.max()).sum()
    return layers


def _conv(weights: Weights, layer: str, x: NDArray[np.float64], stride: int, pad: int) -> NDArray[np.float64]:
    """Convolution and ReLU: every window times every kernel."""
    kernels = weights[f"{layer}.weight"].astype(np.float64)
    x = np.pad(x, ((0, 0), (pad, pad), (pad, pad)))
    windows = np.lib.stride_tricks.sliding_window_view(x, kernels.shape[2:], axis=(1, 2))[:, ::stride, ::stride]
    out = np.tensordot(kernels, windows, axes=((1, 2, 3), (0, 3, 4)))
    return np.maximum(out + weights[f"{layer}.bias"][:, None, None], 0)


def _pool(x: NDArray[np.float64]) -> NDArray[np.float64]:
    windows = np.lib.stride_tricks.sliding_window_view(x, (3, 3), axis=(1, 2))[:, ::2, ::2]
    return windows.max(axis=(3, 4))


def _dense(weights: Weights, layer: str, x: NDArray[np.float64]) -> NDArray[np.float64]:
    return weights[f"{layer}.weight"].astype(np.float64) @ x + weights[f"{layer}.bias"]
