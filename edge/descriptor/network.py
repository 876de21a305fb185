"""fc6 with ONNX Runtime: regions in, descriptors out; and the small head that gives the place category.

The only module that imports ONNX Runtime. From 1.29 on it sends telemetry unless the environment forbids it before the
import, and from 1.28 on it crashes at import on a Cortex-A76, so pyproject.toml requires an earlier version; a test
checks both.
"""

from __future__ import annotations

import os

os.environ["ORT_DISABLE_TELEMETRY"] = "1"

from pathlib import Path

import numkong
import numpy as np
import onnxruntime
from numpy.typing import NDArray

from edge.descriptor.model_file import FC6_FILE, HEAD_FILE, ModelFile, ModelInfo, read_model_file, resolve_model
from edge.errors import ModelError

IMAGE = "image"


def lacks_int8_products() -> bool:
    """Whether this is an x86-64 processor without VNNI, the instructions that add up products of int8 in 32 bits."""
    has = numkong.get_capabilities()  # by CPUID: "icelake" is AVX512-VNNI, "alder" is AVX-VNNI
    return bool(has["haswell"] and not (has["icelake"] or has["alder"]))


def open_session(model: bytes) -> onnxruntime.InferenceSession:
    """A session that runs on the CPU, in the calling thread only."""
    options = onnxruntime.SessionOptions()
    # A second thread gains little and adds jitter; spinning would use a core that other programs need.
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    if lacks_int8_products():
        # Its int8 kernels saturate at 16 bits: the same picture would give another fc6 than on other processors. The
        # precise ones give the same bytes as VNNI. Weights of 7 bits would need neither, and failed `model verify`.
        options.add_session_config_entry("session.x64quantprecision", "1")
    options.log_severity_level = 3  # errors; they are raised as exceptions as well
    # There are no other providers: a fallback would print several lines and fail again.
    session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"], enable_fallback=0)
    session._model_bytes = None  # 40 MB, kept for that fallback alone
    return session


class Network:
    """Regions to fc6. Normalization and channel order are inside the graph: no float image exists outside it."""

    def __init__(self, file: ModelFile) -> None:
        """file: as `read_model_file` returned it. ModelError if the graph does not agree with its metadata."""
        size = file.info.input_size
        if file.info.tap == "categories":
            raise ModelError(f"{file.path}: is the category head; name the network file, {FC6_FILE}")
        self.info = file.info
        self.path = file.path
        self._session = _open_checked(file, IMAGE, "tensor(uint8)", [size, size, 3])

    @classmethod
    def load(cls, path: Path | None = None) -> Network:
        """The shipped network (None), or that of a file or model folder. Raises ModelError, in one line."""
        return cls(read_model_file(resolve_model(path, FC6_FILE)))

    def describe(self, images: NDArray[np.uint8]) -> NDArray[np.float32]:
        """fc6 after ReLU, (B, dimensions) float32, of images (B, input_size, input_size, 3) uint8 BGR, contiguous.

        A batch reads the weights once: two regions take far less than twice the time of one. The descriptor of an
        image does not depend on the others in its batch.
        """
        descriptors: NDArray[np.float32] = self._session.run(None, {IMAGE: images})[0]
        return descriptors


class Head:
    """fc6 to place categories (fc7, fc8, softmax); works only with the fc6 of one network file."""

    def __init__(self, file: ModelFile, network: ModelInfo) -> None:
        """file: as `read_model_file` returned it; ModelError if it does not belong to the network."""
        if file.info.fc6_sha256 != network.sha256:
            raise ModelError(
                f"{file.path}: belongs to the network {file.info.fc6_sha256[:12] or '(none)'}, not to {network.name} "
                f"{network.sha256[:12]}; import the two again with `lookback model import`"
            )
        if len(file.info.labels) != file.info.dimensions:
            raise ModelError(f"{file.path}: {len(file.info.labels)} labels for {file.info.dimensions} categories")
        self.labels = file.info.labels
        self._session = _open_checked(file, "fc6", "tensor(float)", [network.dimensions])

    @classmethod
    def load(cls, network: Network, path: Path | None = None) -> Head:
        """The head beside the network's own file (None), or that of a file or folder. Raises ModelError."""
        file = network.path.with_name(HEAD_FILE) if path is None else resolve_model(path, HEAD_FILE)
        return cls(read_model_file(file), network.info)

    def probabilities(self, descriptors: NDArray[np.float32]) -> NDArray[np.float32]:
        """Softmax over the categories, (R, C) float32, of raw fc6 (R, dimensions) float32."""
        probabilities: NDArray[np.float32] = self._session.run(None, {"fc6": descriptors})[0]
        return probabilities

    def categories(self, descriptors: NDArray[np.float32]) -> tuple[str, float]:
        """Label and probability of the category with the highest mean over the R regions of one frame."""
        mean = self.probabilities(descriptors).mean(axis=0)
        best = int(mean.argmax())
        return self.labels[best], float(mean[best])


def _open_checked(file: ModelFile, name: str, dtype: str, shape: list[int]) -> onnxruntime.InferenceSession:
    """Open a session and check that its input and output agree with the metadata; the first axis is the batch."""
    try:
        session = open_session(file.data)
        tensors = [*session.get_inputs(), *session.get_outputs()]
        found = [(tensor.name, tensor.type, tensor.shape[1:]) for tensor in tensors]
    except Exception as error:  # ONNX Runtime's own classes share only Exception
        reason = str(error).replace("\n", " ")
        raise ModelError(f"{file.path}: ONNX Runtime rejects it: {reason[:300]}") from None
    wanted = [(name, dtype, shape), (file.info.tap, "tensor(float)", [file.info.dimensions])]
    if found != wanted or isinstance(tensors[0].shape[0], int):
        raise ModelError(f"{file.path}: has inputs and outputs {found}, its metadata needs {wanted}")
    return session
