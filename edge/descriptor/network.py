"""Descriptors with ONNX Runtime: pictures in, descriptors out.

The only module that imports ONNX Runtime. From 1.29 on it sends telemetry unless the environment forbids it before the
import; a test watches the calls of the system.
"""

from __future__ import annotations

import os

os.environ["ORT_DISABLE_TELEMETRY"] = "1"

from functools import lru_cache
from pathlib import Path
from typing import Literal

import cv2
import numkong
import numpy as np
import onnxruntime
from numpy.typing import NDArray

from edge.descriptor.model_file import ModelFile, ModelInfo, read_model_file, resolve_model
from edge.errors import ConfigError, ModelError

Regions = Literal["left-right", "whole"]

REGION_COUNT: dict[Regions, int] = {"whole": 1, "left-right": 2}
LARGEST_STEP = 2.5
"""An image that is more times larger than its region's size is halved first: one step of linear interpolation reads two
pixels a side, and what lies between them would be lost."""


def cut_regions(image: NDArray[np.uint8], regions: Regions, width: float, size: tuple[int, int]) -> NDArray[np.uint8]:
    """Cut an image (H, W, 3) into R regions resized to `size` (height, width): (R, height, width, 3) uint8.

    "left-right" uses the outer `width` (fraction of W) at each side, left first, at full height; "whole" ignores
    `width`. Nothing is mirrored: an object seen from behind is not its mirror image.
    """
    width_px = image.shape[1]
    if regions == "whole":
        parts = [image]
    else:
        cut_px = max(1, round(width_px * width))
        parts = [image[:, :cut_px], image[:, width_px - cut_px :]]
    out = np.empty((len(parts), *size, 3), dtype=np.uint8)
    for part, target in zip(parts, out, strict=True):
        _resize(_halved(part, size), size, target)
    return out


def pictures_for(info: ModelInfo, image: NDArray[np.uint8], regions: Regions, width: float) -> NDArray[np.uint8]:
    """What a network is given of an image (H, W, 3): `cut_regions`, or the whole where it finds the regions itself."""
    return cut_regions(image, "whole" if info.columns else regions, width, info.size)


def region_count(info: ModelInfo, regions: Regions) -> int:
    """R of the descriptors (R, D) of one image."""
    return len(info.columns) or REGION_COUNT[regions]


def _halved(image: NDArray[np.uint8], size: tuple[int, int]) -> NDArray[np.uint8]:
    """The image with its sides halved until each is at most LARGEST_STEP times that of `size`."""
    while True:
        steps = [given / wanted for given, wanted in zip(image.shape[:2], size, strict=True)]
        if max(steps) <= LARGEST_STEP:
            return image
        # Both where both may be: OpenCV halves one alone 10 times as slowly as both.
        least = LARGEST_STEP if min(steps) < 2 else 2
        height, width = (
            given // 2 if step >= least else given for given, step in zip(image.shape[:2], steps, strict=True)
        )
        image = _resize(image, (height, width))


def _resize(
    image: NDArray[np.uint8], size: tuple[int, int], target: NDArray[np.uint8] | None = None
) -> NDArray[np.uint8]:
    # In fixed-point numbers, so that every processor gives the same bytes; OpenCV's other filters do not.
    resized = cv2.resize(image, size[::-1], dst=target, interpolation=cv2.INTER_LINEAR_EXACT)
    return np.asarray(resized, dtype=np.uint8)


IMAGE = "image"
CPU = "cpu"
MAX_ARENA_BYTES = 2**30
"""Memory that all networks on the CPU may allocate together. A small file can ask for any amount: the sum of a row and
a column of 100,000 numbers each has 40 GB. A descriptor of two regions needs far less."""
_SUFFIX = "ExecutionProvider"


def installed_providers() -> list[str]:
    """ONNX Runtime's names of the providers of this build, the preferred ones first."""
    return list(onnxruntime.get_available_providers())


def provider_name(given: str) -> str:
    """ONNX Runtime's name of a provider that is installed, such as OpenVINOExecutionProvider for "openvino".

    ConfigError lists those that are.
    """
    available = installed_providers()
    for name in available:
        if given.lower() in (name.lower(), name.removesuffix(_SUFFIX).lower()):
            return str(name)
    short = ", ".join(f'"{name.removesuffix(_SUFFIX)}"' for name in available if name != f"CPU{_SUFFIX}")
    raise ConfigError(
        f'[descriptor] provider: "{given}" is not in this build of ONNX Runtime; there is "{CPU}"'
        + (f" and {short}" if short else "")
    )


def lacks_int8_products() -> bool:
    """Whether this is an x86-64 processor without VNNI, the instructions that add up products of int8 in 32 bits."""
    has = numkong.get_capabilities()  # by CPUID: "icelake" is AVX512-VNNI, "alder" is AVX-VNNI
    return bool(has["haswell"] and not (has["icelake"] or has["alder"]))


@lru_cache(maxsize=1)
def _limit_memory() -> None:
    """Register the one allocator that all sessions on the CPU share; ONNX Runtime accepts it once in a process."""
    kind = onnxruntime.OrtAllocatorType.ORT_ARENA_ALLOCATOR
    memory = onnxruntime.OrtMemoryInfo("Cpu", kind, 0, onnxruntime.OrtMemType.DEFAULT)
    onnxruntime.create_and_register_allocator(memory, onnxruntime.OrtArenaCfg({"max_mem": MAX_ARENA_BYTES}))


def open_session(model: bytes, provider: str = CPU) -> onnxruntime.InferenceSession:
    """A session that runs in the calling thread only, on the CPU or where an installed provider runs it."""
    options = onnxruntime.SessionOptions()
    # A second thread gains little and adds jitter; spinning would use a core that other programs need.
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    _limit_memory()
    options.add_session_config_entry("session.use_env_allocators", "1")
    if lacks_int8_products():
        # Its int8 kernels saturate at 16 bits: the same picture would give another fc6 than on other processors. The
        # precise ones give the same bytes as VNNI. Weights of 7 bits would need neither, and failed `model verify`. All
        # layers need them: each has neighboring weights of one sign that exceed 128 together, which 255 times saturate.
        options.add_session_config_entry("session.x64quantprecision", "1")
    options.log_severity_level = 4  # errors are raised as exceptions, and need not be printed as well
    providers = list(dict.fromkeys((provider_name(provider), f"CPU{_SUFFIX}")))  # the CPU runs what the other cannot
    # A fallback to another provider would print several lines and fail again.
    session = onnxruntime.InferenceSession(model, options, providers=providers, enable_fallback=0)
    session._model_bytes = None  # 40 MB, kept for that fallback alone
    return session


class Network:
    """Regions to descriptors. Normalization and channel order are in the graph: no float image exists outside it."""

    def __init__(self, file: ModelFile, provider: str = CPU) -> None:
        """file: as `read_model_file` returned it. provider: "cpu", or that of an accelerator.

        ModelError if the graph does not agree with its metadata; ConfigError if the provider is not installed.
        """
        self.info = file.info
        self.size = file.info.size
        """Height and width of its images, in pixels."""
        self.path = file.path
        self.provider = provider
        self._session = _open_checked(file, IMAGE, np.uint8, [*self.size, 3], provider)

    @classmethod
    def load(cls, path: Path | None = None, provider: str = CPU) -> Network:
        """fc6 (None), or the network of a name, file or model folder. Raises ModelError, in one line."""
        return cls(read_model_file(resolve_model(path)), provider)

    def describe(self, images: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Raw descriptors (B, dimensions) float32 of images (B, height, width, 3) uint8 BGR, contiguous.

        Of a network that returns R regions of a picture: (B * R, dimensions), those of each picture together. A batch
        reads the weights once: two regions take far less than twice the time of one. The descriptor of an image does
        not depend on the others in its batch.
        """
        return _run(self._session, IMAGE, images).reshape(-1, self.info.dimensions)


def _run(session: onnxruntime.InferenceSession, name: str, batch: NDArray[np.generic]) -> NDArray[np.float32]:
    """The output for a batch; one after the other where the graph works only with a batch of one."""
    pieces = [batch] if session.get_inputs()[0].shape[0] != 1 else np.split(batch, len(batch))
    found: list[NDArray[np.float32]] = [session.run(None, {name: piece})[0] for piece in pieces]
    return found[0] if len(found) == 1 else np.concatenate(found)


def _open_checked(
    file: ModelFile, name: str, dtype: type[np.generic], shape: list[int], provider: str = CPU
) -> onnxruntime.InferenceSession:
    """Open a session, check that input and output agree with the metadata, and run it once; the first axis is B."""
    try:
        session = open_session(file.data, provider)
        tensors = [*session.get_inputs(), *session.get_outputs()]
        found = [(tensor.name, tensor.type, tensor.shape[1:]) for tensor in tensors]
    except ConfigError:
        raise
    except Exception as error:  # ONNX Runtime's own classes share only Exception
        raise _rejected(file, error) from None
    kind = "uint8" if dtype is np.uint8 else "float"
    wanted = [(name, f"tensor({kind})", shape), (file.info.output, "tensor(float)", file.info.shape)]
    if found != wanted or (tensors[0].shape[0] != 1 and isinstance(tensors[0].shape[0], int)):
        raise ModelError(f"{file.path}: has inputs and outputs {found}, its metadata needs {wanted}")
    try:
        given = _run(session, name, np.zeros((2, *shape), dtype)).shape
    except Exception as error:
        raise _rejected(file, error) from None
    if given != (2, *file.info.shape):
        raise ModelError(f"{file.path}: gives {given} for two images, its metadata needs {(2, *file.info.shape)}")
    return session


def _rejected(file: ModelFile, error: Exception) -> ModelError:
    reason = str(error).replace("\n", " ")
    return ModelError(f"{file.path}: ONNX Runtime rejects it: {reason[:300]}")
