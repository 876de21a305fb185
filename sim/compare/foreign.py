"""Networks of others: any ONNX file that makes a descriptor of an image, as its authors export it."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.config import NETWORKS
from edge.descriptor.model_file import METADATA_KEY, ModelInfo, resolve_model
from edge.descriptor.network import CPU, Network
from edge.errors import ConfigError, ModelError, reason
from sim.compare.plan import NetworkPlan

import onnxruntime  # isort: skip  # after the network's import, which turns its telemetry off

Triple = tuple[float, float, float]
IMAGENET_MEAN: Triple = (0.485, 0.456, 0.406)
IMAGENET_STD: Triple = (0.229, 0.224, 0.225)
"""Of RGB images from 0 to 1: what nearly all published networks were trained with."""
TYPES = {"tensor(float)": np.float32, "tensor(float16)": np.float16}


class ForeignNetwork(Network):
    """A network of one input (B, 3, h, w), RGB, and of an output (B, D), or (B, tokens, D) with a class token first.

    It runs on all cores, on the CPU. Its file is loaded by ONNX Runtime as it is: use files that you trust.
    """

    def __init__(
        self, path: Path, size: tuple[int, int] | None = None, mean: Triple = IMAGENET_MEAN, std: Triple = IMAGENET_STD
    ) -> None:
        """size: height and width of its images, where the file leaves them open. ModelError in one line."""
        self.path, self.provider = path, CPU
        self._session = _session(path)
        tensors = self._session.get_inputs()
        shape = tensors[0].shape
        if len(tensors) != 1 or len(shape) != 4 or shape[1] != 3 or tensors[0].type not in TYPES:
            found = ", ".join(f"{one.name} {one.type} {one.shape}" for one in tensors)
            raise ModelError(f"{path}: needs one input (batch, 3, height, width) of float numbers, has {found}")
        self._input, self._type, self._one_by_one = tensors[0].name, TYPES[tensors[0].type], shape[0] == 1
        fixed = tuple(side for side in shape[2:] if isinstance(side, int) and side > 0)
        if size is None and len(fixed) < 2:
            raise ModelError(
                f"{path}: works with images of any size; give the one that it was trained with, as 320x320"
            )
        self.size = size if size is not None else (fixed[0], fixed[1])
        self._mean, self._scale = (255 * np.array(mean)).astype(np.float32), 1 / (255 * np.array(std, np.float32))
        self._output = self._chosen_output()
        dimensions = self._run(np.zeros((1, *self.size, 3), np.uint8)).shape[1]
        self.info = ModelInfo(
            name=path.stem,
            tap=self._output,
            dimensions=dimensions,
            precision="float32",
            input_size=self.size,
            channel_order="BGR",
            mean_rgb=mean,
            std_rgb=std,
            license="that of its authors",
            source=path.name,
            weights_sha256="",
            calibration="",
            sha256=hashlib.sha256(path.read_bytes()).hexdigest(),
        )

    def _chosen_output(self) -> str:
        """The first descriptor among the outputs; else the first with tokens, as a vision transformer's."""
        outputs = self._session.get_outputs()
        for rank in (2, 3):
            for one in outputs:
                if len(one.shape) == rank:
                    return str(one.name)
        found = ", ".join(f"{one.name} {one.shape}" for one in outputs)
        raise ModelError(f"{self.path}: needs an output (batch, dimensions), has {found}; export it with its pooling")

    def describe(self, images: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Raw descriptors (B, dimensions) float32 of images (B, height, width, 3) uint8 BGR."""
        if self._one_by_one:
            return np.concatenate([self._run(image[np.newaxis]) for image in images])
        return self._run(images)

    def _run(self, images: NDArray[np.uint8]) -> NDArray[np.float32]:
        scaled = (images[..., ::-1].astype(np.float32) - self._mean) * self._scale
        batch = np.ascontiguousarray(scaled.transpose(0, 3, 1, 2).astype(self._type))
        try:
            found = self._session.run([self._output], {self._input: batch})[0]
        except Exception as error:  # ONNX Runtime's own classes share only Exception
            raise _rejected(self.path, error) from None
        if found.ndim == 3:
            found = found[:, 0]
        if found.ndim != 2 or len(found) != len(images) or not np.isfinite(found).all():
            raise ModelError(
                f"{self.path}: gives {found.shape} for {len(images)} images, or numbers that are not finite"
            )
        return np.asarray(found, dtype=np.float32)


def open_file(
    path: Path, size: tuple[int, int] | None = None, mean: Triple = IMAGENET_MEAN, std: Triple = IMAGENET_STD
) -> Network:
    """A network's file, of `lookback model import` or of others. ModelError in one line."""
    if METADATA_KEY in _session(path).get_modelmeta().custom_metadata_map:
        return Network.load(path)
    return ForeignNetwork(path, size, mean, std)


def _session(path: Path) -> Any:
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 4
    try:
        with path.open("rb"):
            return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except OSError as error:
        raise ModelError(f"{path}: cannot read the network: {reason(error)}") from None
    except Exception as error:
        raise _rejected(path, error) from None


def _rejected(path: Path, error: Exception) -> ModelError:
    return ModelError(f"{path}: ONNX Runtime rejects it: {' '.join(str(error).split())[:300]}")


def open_network(name: str, plan: NetworkPlan, folder: Path) -> Network:
    """ConfigError names what is missing."""
    if plan.model in NETWORKS:
        return Network.load(Path(plan.model))
    file = folder / plan.model
    file = resolve_model(file) if file.is_dir() else file
    if not file.is_file():
        raise ConfigError(f"[networks.{name}]: {file}: no such network")
    return open_file(file, plan.size, plan.mean, plan.std)
