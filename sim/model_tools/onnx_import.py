"""Any ONNX image network to a float graph that Lookback can use: pixels in, one descriptor per image out.

    image (1, H, W, 3) uint8 BGR -> normalization, channel order, layout -> the network up to the tap -> grid -> (1, D)
                                                                             or the grid's outer columns -> (1, 2, D)

ONNX Runtime folds and renames, and onnx cuts. Neither has a tool for the grid, and for the normalization of pixels that
goes into the first convolution.

It is made for one image at a time, so that everything that does not depend on the image becomes a constant: two regions
take twice the time of one, as they do in a batch of convolutions. `onnx` and `onnxruntime` run the file, so it must be
one that you trust.
"""

from __future__ import annotations

import difflib
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from edge.descriptor.model_file import output_name
from edge.descriptor.network import IMAGE, open_session
from edge.errors import ModelError
from sim.model_tools.onnx_graph import MEAN_RGB, NORMALIZE, STD_RGB
from sim.output import needing

if TYPE_CHECKING:
    import onnx

OPSET = 17  # read by ONNX Runtime since 1.12
DIMENSIONS = (64, 32_768)
"""Least and greatest number of dimensions of a descriptor."""
OLDEST_OPSET = 13  # from which on a scale per channel can be written
_INT8 = "DequantizeLinear QuantizeLinear"
_ACTIVATIONS = "Clip Elu Erf Gelu HardSigmoid HardSwish LeakyRelu PRelu Relu Sigmoid Softmax Sqrt Tanh"
_LAYERS = "AveragePool Conv Flatten Gemm GlobalAveragePool GlobalMaxPool MatMul MaxPool"
_NORMALIZATIONS = "BatchNormalization InstanceNormalization LRN LayerNormalization LpNormalization"
_ARITHMETIC = "Abs Add Div Exp Max Min Mul Neg Pow Reciprocal ReduceL2 ReduceMean ReduceSum Sub"
_SHAPES = "Cast Concat Expand Gather Pad Reshape Resize Slice Split Squeeze Transpose Unsqueeze"
OPERATORS = frozenset(" ".join((_INT8, _ACTIVATIONS, _LAYERS, _NORMALIZATIONS, _ARITHMETIC, _SHAPES)).split())
"""What a network for images needs, and none that makes tensors of nothing: a vehicle does not look again."""
INPUT = "input"
DEFAULT_SIZE = 224
Layout = Literal["nchw", "nhwc"]
Columns = tuple[tuple[int, ...], ...]
"""Those of a grid in each region, in their order."""


@dataclass(frozen=True)
class ImageInput:
    """How the network wants its image. size: height and width; None for what the file says.

    mean_rgb, std_rgb: over 0..1. channels: the order that the network expects. layout: None for what the file says.
    """

    size: tuple[int, int] | None = None
    layout: Layout | None = None
    mean_rgb: tuple[float, float, float] = MEAN_RGB
    std_rgb: tuple[float, float, float] = STD_RGB
    channels: Literal["RGB", "BGR"] = "RGB"

    @property
    def gray(self) -> int:
        """The gray level that stands for nothing: the mean, which is also what lies beyond the edge of the picture."""
        return int(np.clip(round(255 * float(np.mean(self.mean_rgb))), 0, 255))


@dataclass(frozen=True)
class FloatGraph:
    """A float graph without metadata. size: height and width."""

    model: onnx.ModelProto
    size: tuple[int, int]
    dimensions: int
    tap: str
    columns: Columns = ()


def import_onnx(
    path: Path,
    data: bytes,
    wanted: ImageInput,
    tap: str = "",
    pool: tuple[int, int] | None = None,
    columns: int | None = None,
) -> FloatGraph:
    """Cut the network at `tap` ("" is its output), average over a grid (rows, columns), and put pixels in front.

    columns: so many of the grid's on each side become the left and the right region, each from the outside in.

    ModelError names the file, and the tensor with what is there instead.
    """
    try:
        model = _load(data)
        image, size, layout = _image_input(model, wanted)
        tap = tap or model.graph.output[0].name
        _check_tap(model, tap)
        cut = _cut(_fold(model, image, size, layout, tap), image, tap)
        _check_operators(cut)
        regions = _outer_columns(pool, columns)
        shape, one = _add_pool(cut, tap, pool, regions, _run(cut, image, size, layout))
        _add_pixels(cut, image, size, layout, wanted)
        whole = _finish(cut, one, shape)
    except ModelError as error:
        raise ModelError(f"{path}: {error}") from None
    return FloatGraph(whole, size, shape[-1], tap, regions)


def _load(data: bytes) -> onnx.ModelProto:
    with needing("importing a model", "model", ModelError):
        import onnx
        from google.protobuf.message import DecodeError
    try:
        model = onnx.load_model_from_string(data)
    except (DecodeError, ValueError):
        raise ModelError("not a whole ONNX file") from None
    if not model.graph.node or not model.graph.output:
        raise ModelError("not an ONNX network: it has no operators or no output")
    if any(tensor.data_location == onnx.TensorProto.EXTERNAL for tensor in model.graph.initializer):
        raise ModelError("keeps weights in another file; save it as one file (onnx.save without external data)")
    opset = next((one.version for one in model.opset_import if one.domain in ("", "ai.onnx")), 0)
    if opset < OLDEST_OPSET:
        try:
            return onnx.version_converter.convert_version(model, OPSET)
        except Exception as error:  # the converter is C++ and raises several kinds
            raise ModelError(f"has opset {opset}, which cannot be converted to {OPSET}: {_line(error)}") from None
    return model


def _image_input(model: onnx.ModelProto, wanted: ImageInput) -> tuple[str, tuple[int, int], Layout]:
    """Name, height and width, and layout of the one input."""
    import onnx

    constants = {tensor.name for tensor in model.graph.initializer}
    inputs = [one for one in model.graph.input if one.name not in constants]
    if len(inputs) != 1:
        names = ", ".join(one.name for one in inputs)
        raise ModelError(f"has {len(inputs)} inputs ({names}); a network with one image as its input is needed")
    name, tensor = inputs[0].name, inputs[0].type.tensor_type
    shape = [one.dim_value if one.dim_value > 0 else None for one in tensor.shape.dim]
    spelled = f"({', '.join('?' if one is None else str(one) for one in shape)})"
    if tensor.elem_type != onnx.TensorProto.FLOAT or len(shape) != 4:
        kind = str(onnx.TensorProto.DataType.Name(tensor.elem_type)).lower()
        raise ModelError(f"input {name!r} is {kind} {spelled}; float of 4 dimensions is needed")
    layout: Layout | None = wanted.layout or ("nchw" if shape[1] == 3 else "nhwc" if shape[3] == 3 else None)
    if layout is None:
        raise ModelError(f"input {name!r} has the shape {spelled}, with no axis of 3 channels; give --layout")
    if shape[1 if layout == "nchw" else 3] not in (3, None):
        raise ModelError(f"input {name!r} has the shape {spelled}, which is not {layout} with 3 channels")
    given = shape[2:] if layout == "nchw" else shape[1:3]
    size = tuple(one or two for one, two in zip(given, wanted.size or (DEFAULT_SIZE,) * 2, strict=True))
    if wanted.size and size != wanted.size:
        raise ModelError(f"input {name!r} has the fixed shape {spelled}, which is not --size {spell(wanted.size)}")
    return name, (size[0], size[1]), layout


def spell(size: Iterable[int]) -> str:
    """Such as 4x4."""
    return "x".join(str(one) for one in size)


def _check_tap(model: onnx.ModelProto, tap: str) -> None:
    names = [name for node in model.graph.node for name in node.output if name]
    if tap not in names:
        near = difflib.get_close_matches(tap, names, 3, 0.3) or names[-3:]
        raise ModelError(f"has no tensor {tap!r}; near it is {', '.join(map(repr, near))}")


def _fold(model: onnx.ModelProto, image: str, size: tuple[int, int], layout: Layout, tap: str) -> onnx.ModelProto:
    """The network for a batch of one, with all that does not depend on the image computed, in standard operators."""
    import onnx
    from onnxruntime.tools.onnx_model_utils import optimize_model  # by now with its telemetry disabled

    given = next(one for one in model.graph.input if one.name == image)
    shape = [1, 3, *size] if layout == "nchw" else [1, *size, 3]
    given.CopyFrom(onnx.helper.make_tensor_value_info(image, onnx.TensorProto.FLOAT, shape))
    del model.graph.output[:]
    del model.graph.value_info[:]
    model.graph.output.append(onnx.helper.make_tensor_value_info(tap, onnx.TensorProto.FLOAT, None))
    with tempfile.TemporaryDirectory() as folder:
        whole, folded = Path(folder) / "whole.onnx", Path(folder) / "folded.onnx"
        onnx.save(model, whole)
        try:
            optimize_model(whole, folded, log_level=4)
            return onnx.load(folded)
        except Exception as error:  # ONNX Runtime's own classes share only Exception
            raise ModelError(f"ONNX Runtime rejects it with an image of {spell(size)}: {_line(error)}") from None


def _cut(model: onnx.ModelProto, image: str, tap: str) -> onnx.ModelProto:
    """What the tap is computed from, with the tap as the one output."""
    cut = _extract(model, image, tap)
    for number, node in enumerate(cut.graph.node):
        node.name = f"{number} {node.op_type}"  # exporters need not name them
    domains = [one for one in model.opset_import if one.domain in ("", "ai.onnx")]
    del cut.opset_import[:]
    cut.opset_import.extend(domains)
    return cut


def _extract(model: onnx.ModelProto, image: str, output: str) -> onnx.ModelProto:
    """The nodes and constants between the two, of a model that has both as its own input and output."""
    import onnx

    found = onnx.utils.Extractor(model).extract_model([image], [output])
    del found.graph.value_info[:]  # which has both as they are now
    return found


def _check_operators(model: onnx.ModelProto) -> None:
    for node in model.graph.node:
        if node.op_type not in OPERATORS or node.domain not in ("", "ai.onnx"):
            raise ModelError(
                f"tensor {node.output[0]!r} is computed by {node.op_type}, which Lookback does not run; tap it before"
            )


def _run(model: onnx.ModelProto, image: str, size: tuple[int, int], layout: Layout) -> tuple[int, ...]:
    """The shape of the tap for one image."""
    shape = (1, 3, *size) if layout == "nchw" else (1, *size, 3)
    try:
        found = open_session(model.SerializeToString()).run(None, {image: np.zeros(shape, np.float32)})[0]
    except Exception as error:  # ONNX Runtime's own classes share only Exception
        raise ModelError(f"ONNX Runtime rejects it: {_line(error)}") from None
    if found.dtype != np.float32 or found.shape[:1] != (1,) or found.ndim < 2:
        tap = model.graph.output[0].name
        raise ModelError(f"tensor {tap!r} is {found.dtype} {found.shape}; float32 with an axis for the batch is needed")
    return tuple(found.shape)


def _outer_columns(pool: tuple[int, int] | None, count: int | None) -> Columns:
    """The columns of the left and of the right region, so many of the grid's on each side, the outermost first.

    From the outside in on both sides: what the left region of one camera sees outermost, the right one of a camera
    that faces the other way sees outermost as well.
    """
    if count is None:
        return ()
    if pool is None or not 1 <= count <= pool[1] // 2:
        most = f"1 to {pool[1] // 2} of --pool {spell(pool)}" if pool else "those of a --pool"
        raise ModelError(f"--columns {count}: {most} can be a region")
    return tuple(range(count)), tuple(range(pool[1] - 1, pool[1] - 1 - count, -1))


def _add_pool(
    model: onnx.ModelProto, tap: str, pool: tuple[int, int] | None, columns: Columns, shape: tuple[int, ...]
) -> tuple[list[int], str]:
    """Average a feature map over a grid, or flatten what has more axes than two; shape of an image's, and its name.

    columns: of the grid, those of each region that the network returns.
    """
    import onnx
    from onnxruntime.quantization.onnx_model import ONNXModel

    cells = pool[0] * (len(columns[0]) if columns else pool[1]) if pool else 1
    if pool and len(shape) != 4:
        raise ModelError(f"tensor {tap!r} has the shape {_batched(shape)}; only a feature map (B, C, H, W) has a grid")
    if pool and (pool[0] > shape[2] or pool[1] > shape[3]):
        raise ModelError(f"tensor {tap!r} has the shape {_batched(shape)}, which is smaller than --pool {spell(pool)}")
    dimensions = shape[1] * cells if pool else int(np.prod(shape[1:]))
    if not DIMENSIONS[0] <= dimensions <= DIMENSIONS[1]:
        raise ModelError(
            f"tensor {tap!r} has the shape {_batched(shape)}, which gives {dimensions} dimensions;"
            f" {DIMENSIONS[0]} to {DIMENSIONS[1]} can be used" + ("" if len(shape) < 4 else ": choose another --pool")
        )
    if len(shape) == 2:
        return [dimensions], tap
    inner, name = f"{tap}.map", output_name(tap, spell(pool) if pool else "", columns)
    names, make = ONNXModel(model), onnx.helper.make_node
    names.replace_output_of_all_nodes(tap, inner)
    names.replace_input_of_all_nodes(tap, inner)
    if pool:
        grid, flat, chosen = _grid(shape[2:], pool), f"{inner}.flat", f"{inner}.cells"
        constants: dict[str, NDArray[Any]] = {"sizes": np.array([-1, dimensions], np.int64)}
        if columns:  # each region's cells side by side, then the regions apart
            grid = grid[:, [row * pool[1] + column for one in columns for row in range(pool[0]) for column in one]]
            constants["apart"] = np.array([-1, shape[1], len(columns), cells], np.int64)
            constants["sizes"] = np.array([-1, len(columns), dimensions], np.int64)
        constants["grid"] = grid
        model.graph.initializer.extend(
            onnx.numpy_helper.from_array(array, f"{NORMALIZE}.{key}") for key, array in constants.items()
        )
        model.graph.node.append(make("Flatten", [inner], [flat], f"{NORMALIZE}.flat", axis=2))
        model.graph.node.append(make("Gemm", [flat, f"{NORMALIZE}.grid"], [chosen], f"{NORMALIZE}.cells"))
        if columns:
            apart, regions = f"{inner}.apart", f"{inner}.regions"
            model.graph.node.append(make("Reshape", [chosen, f"{NORMALIZE}.apart"], [apart], f"{NORMALIZE}.apart"))
            model.graph.node.append(make("Transpose", [apart], [regions], f"{NORMALIZE}.regions", perm=[0, 2, 1, 3]))
            chosen = regions
        model.graph.node.append(make("Reshape", [chosen, f"{NORMALIZE}.sizes"], [name], f"{NORMALIZE}.reshape"))
    else:
        model.graph.node.append(make("Flatten", [inner], [name], f"{NORMALIZE}.flat", axis=1))
    return [*filter(None, [len(columns)]), dimensions], name


def _batched(shape: tuple[int, ...]) -> str:
    return f"(B, {', '.join(map(str, shape[1:]))})"


def _grid(size: tuple[int, ...], pool: tuple[int, int]) -> NDArray[np.float32]:
    """(H * W, cells): the share of each pixel of a map in each cell, of cells that cover it as evenly as they can."""
    shares = []
    for length, count in zip(size, pool, strict=True):
        cells = [(int(np.floor(a)), int(np.ceil(b))) for a, b in pairwise(np.arange(count + 1) * length / count)]
        shares.append(np.array([[(a <= at < b) / (b - a) for a, b in cells] for at in range(length)]))
    return np.asarray(np.kron(shares[0], shares[1]), np.float32)


def _add_pixels(model: onnx.ModelProto, image: str, size: tuple[int, int], layout: Layout, wanted: ImageInput) -> None:
    """Put in front what makes the network's input of pixels: into its first convolution where that is possible."""
    import onnx
    from onnxruntime.quantization.onnx_model import ONNXModel

    make, array = onnx.helper.make_node, onnx.numpy_helper.from_array
    graph, normalized = model.graph, f"{image}.normalized"
    ONNXModel(model).replace_input_of_all_nodes(image, normalized)
    weights = {tensor.name: onnx.numpy_helper.to_array(tensor) for tensor in graph.initializer}
    readers = [node for node in graph.node if normalized in node.input]
    front = [
        make("DequantizeLinear", [IMAGE, "step", "grey"], ["image.pixels"], "pixels"),
        make("Transpose", ["image.pixels"], [INPUT], INPUT, perm=[0, 3, 1, 2]),
    ]
    graph.initializer.extend([array(np.array(1, np.float32), "step"), array(np.array(wanted.gray, np.uint8), "grey")])
    if layout == "nchw" and all(node.op_type == "Conv" and node.input[1] in weights for node in readers):
        for node in readers:
            _prepare(graph, node, weights, wanted)
            node.input[0] = INPUT
    else:
        eye = np.eye(3, dtype=np.float32)[:, :, None, None]
        graph.initializer.append(array(eye, f"{NORMALIZE}.eye"))
        channels = make("Conv", [INPUT, f"{NORMALIZE}.eye"], [f"{NORMALIZE}.nchw"], NORMALIZE, kernel_shape=[1, 1])
        perm = [0, 1, 2, 3] if layout == "nchw" else [0, 2, 3, 1]
        front += [channels, make("Transpose", [f"{NORMALIZE}.nchw"], [normalized], f"{NORMALIZE}.layout", perm=perm)]
        _prepare(graph, channels, {f"{NORMALIZE}.eye": eye}, wanted)
    nodes = [*front, *graph.node]
    del graph.node[:]
    graph.node.extend(nodes)
    del graph.input[:]
    graph.input.append(onnx.helper.make_tensor_value_info(IMAGE, onnx.TensorProto.UINT8, [1, *size, 3]))


def _prepare(graph: Any, node: Any, weights: dict[str, NDArray[Any]], wanted: ImageInput) -> None:
    """Put the normalization of RGB, and the order BGR of what comes in, into a convolution's weights and bias.

    w (x / 255 - mean) / std + b = w' (x - gray) + b', with w' = w / (255 std), b' = b + sum w' (gray - 255 mean)
    """
    import onnx

    weight = weights[node.input[1]].astype(np.float64)
    old = weights[node.input[2]] if len(node.input) > 2 else np.zeros(len(weight))
    order = slice(None, None, -1) if wanted.channels == "BGR" else slice(None)
    mean, std = (255 * np.array(given)[order].reshape(1, 3, 1, 1) for given in (wanted.mean_rgb, wanted.std_rgb))
    scaled = weight / std
    bias = old + (scaled * (wanted.gray - mean)).sum(axis=(1, 2, 3))
    bgr = scaled if wanted.channels == "BGR" else scaled[:, ::-1]
    names = [f"{node.output[0]}.{kind}" for kind in ("pixel_weight", "pixel_bias")]
    arrays = (np.ascontiguousarray(bgr, np.float32), bias.astype(np.float32))
    graph.initializer.extend(onnx.numpy_helper.from_array(*one) for one in zip(arrays, names, strict=True))
    node.input[1:] = names


def _finish(model: onnx.ModelProto, output: str, shape: list[int]) -> onnx.ModelProto:
    """The model with its output, without what that does not need."""
    import onnx

    del model.graph.output[:]
    model.graph.output.append(onnx.helper.make_tensor_value_info(output, onnx.TensorProto.FLOAT, [1, *shape]))
    whole = _extract(model, IMAGE, output)
    try:
        onnx.checker.check_model(whole)
    except onnx.checker.ValidationError as error:
        raise ModelError(f"the simplified network is not valid: {_line(error)}") from None
    return whole


def _line(error: Exception) -> str:
    return str(error).replace("\n", " ")[:300]
