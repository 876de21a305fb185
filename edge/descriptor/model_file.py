"""The network's file: read once, hashed, and checked before ONNX Runtime is given its bytes.

ONNX Runtime computes constants while it loads a model, and makes sparse weights dense even with all optimizations off,
so a file of 200 bytes can fill the memory of the computer: the test
`test_onnx_runtime_itself_fills_the_memory_for_a_small_file` shows both. What `lookback model import` writes has
only the operators below and no constants that are computed; anything else is refused here before memory is allocated.
What the operators themselves may allocate is limited in `network.py`.
The field numbers are those of onnx.proto (https://github.com/onnx/onnx/blob/main/onnx/onnx.proto).
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

import msgspec

from edge.errors import ModelError
from edge.extras import install_command

FC6_FILE, NETWORK_FILE = "fc6_int8.onnx", "network_int8.onnx"
"""The network file of a model folder: of an AlexNet, and of any other network."""
GRID = Path(__file__).parent / "models" / "grid" / "network_float32.onnx"
XFEAT = Path(__file__).parents[1] / "keypoints" / "models" / "xfeat" / "network_float32.onnx"
"""The network of `edge.keypoints`."""
FC6_PACKAGE = "lookback_fc6"
FC6_NAME = "alexnet_places100"

METADATA_KEY = "lookback"
MAX_FILE_BYTES = 512 * 2**20  # the float graph of AlexNet to fc6 is 161 MB
MAX_ATTRIBUTE = 4096  # kernel, stride and padding of a convolution are far smaller
_INT8 = "DequantizeLinear QuantizeLinear"
_ACTIVATIONS = "Clip Elu Erf Gelu HardSigmoid HardSwish LeakyRelu PRelu Relu Sigmoid Softmax Sqrt Tanh"
_LAYERS = "AveragePool Conv Flatten Gemm GlobalAveragePool GlobalMaxPool MatMul MaxPool"
_NORMALIZATIONS = "BatchNormalization InstanceNormalization LRN LayerNormalization LpNormalization"
_ARITHMETIC = "Abs Add Div Exp Max Min Mul Neg Pow Reciprocal ReduceL2 ReduceMean ReduceSum Sub"
_SHAPES = "Cast Concat Expand Gather Pad Reshape Resize Slice Split Squeeze Transpose Unsqueeze"
OPERATORS = frozenset(" ".join((_INT8, _ACTIVATIONS, _LAYERS, _NORMALIZATIONS, _ARITHMETIC, _SHAPES)).split())

_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5
_Value = int | memoryview


class ModelInfo(msgspec.Struct, frozen=True, kw_only=True):
    """The description in a network file, as JSON under the key `lookback` of ONNX's metadata_props.

    tap: the tensor that the descriptor is made of (fc6 and conv3 of an AlexNet, after ReLU).
    pool: the grid, such as 2x2, over whose cells a feature map is averaged; "" where the tap is used as it is.
    columns: of that grid, those of each region, outer ones first, if the network takes the whole picture and returns
    its regions; empty where it takes each region as a picture of its own.
    dimensions: values per region. input_size: of the square image, or its height and width, in pixels.
    channel_order: of the image that the file is given. weights_sha256: the weights file that it was made from.
    sha256: the file itself, set on reading.
    """

    name: str
    tap: str
    dimensions: int
    precision: Literal["int8", "float32"]
    input_size: int | tuple[int, int]
    channel_order: Literal["BGR"]
    mean_rgb: tuple[float, float, float]
    std_rgb: tuple[float, float, float]
    license: str = msgspec.field(name="licence")  # as the files that were made so far have it
    source: str
    weights_sha256: str
    calibration: str
    sha256: str = ""
    pool: str = ""
    columns: tuple[tuple[int, ...], ...] = ()

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of the image, in pixels."""
        size = self.input_size
        return (size, size) if isinstance(size, int) else size

    @property
    def output(self) -> str:
        """What the network gives, as maps name it: the tap, and the grid and its columns if there are any."""
        return output_name(self.tap, self.pool, self.columns)

    @property
    def shape(self) -> list[int]:
        """Of what the network gives for one image: (D,), or (R, D) of its regions."""
        return [*filter(None, [len(self.columns)]), self.dimensions]


def output_name(tap: str, pool: str, columns: tuple[tuple[int, ...], ...]) -> str:
    """Of a file's output, such as "fc6", or "block12 4x8 0,1,2 7,6,5"."""
    return " ".join([tap, *filter(None, [pool]), *(",".join(map(str, one)) for one in columns)])


@dataclass(frozen=True)
class ModelFile:
    """The bytes of a network file that passed the checks, and its description."""

    path: Path
    data: bytes
    info: ModelInfo


def resolve_model(path: Path | None, name: str = FC6_FILE) -> Path:
    """The file `name` of fc6 (None), of one of NETWORKS, or of a model folder; any other path is the file itself.

    In a folder without `name`, its NETWORK_FILE if it has one. ModelError where fc6 is not installed.
    """
    if path is None or str(path) == "fc6":
        path = fc6_folder()
    elif str(path) in ("grid", "xfeat"):
        path = GRID if str(path) == "grid" else XFEAT
    if not path.is_dir():
        return path
    other = path / NETWORK_FILE
    return other if name == FC6_FILE and not (path / name).exists() and other.exists() else path / name


def fc6_folder() -> Path:
    """Of the package lookback-fc6: beside `edge`, as in a clone and in most installations, or where Python finds it."""
    beside = Path(__file__).parents[2] / FC6_PACKAGE
    if beside.is_dir():
        return beside
    found = find_spec(FC6_PACKAGE)
    if found is None or found.origin is None:
        raise ModelError(
            "the network fc6 is a package of its own, for non-commercial use, and is not installed:"
            f' {install_command("fc6")}; or set [descriptor] model = "grid", for which maps must be built again'
        )
    return Path(found.origin).parent


def network_of_map(name: str) -> str:
    """What `[descriptor] model` is for a map whose network has this name; "" where Lookback does not know it."""
    return {"grid": "grid", FC6_NAME: "fc6"}.get(name, "")


def read_model_file(path: Path) -> ModelFile:
    """Read, hash and check one file; ModelError in one line."""
    try:
        size = path.stat().st_size
        if size > MAX_FILE_BYTES:
            raise ModelError(f"{path}: {size} bytes; a network has at most {MAX_FILE_BYTES}")
        data = path.read_bytes()
    except OSError as error:
        raise ModelError(f"{path}: cannot read the network: {error.strerror}") from None
    try:
        metadata = _check_model(memoryview(data))
    except (ValueError, IndexError):  # of the wire format: varint cut short, length past the end, not UTF-8
        raise ModelError(f"{path}: not a whole ONNX file; copy it again or run `lookback model import`") from None
    except ModelError as error:
        raise ModelError(f"{path}: {error}; use a file that `lookback model import` wrote") from None
    return ModelFile(path, data, _decode_info(path, metadata, hashlib.sha256(data).hexdigest()))


def _decode_info(path: Path, metadata: dict[str, bytes], sha256: str) -> ModelInfo:
    if METADATA_KEY not in metadata:
        raise ModelError(f"{path}: no {METADATA_KEY!r} in its metadata; make it with `lookback model import`")
    try:
        info = msgspec.json.decode(metadata[METADATA_KEY], type=ModelInfo)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:  # ValidationError is a DecodeError
        raise ModelError(f"{path}: metadata {METADATA_KEY!r}: {error}") from None
    return msgspec.structs.replace(info, sha256=sha256)


def _check_model(model: memoryview) -> dict[str, bytes]:
    """Check a ModelProto; returns its metadata_props."""
    metadata: dict[str, bytes] = {}
    graphs = 0
    for field, value in _fields(model):
        if field == 7:
            graphs += 1
            _check_graph(_message(value))
        elif field == 14:
            entry = {key: bytes(_message(text)) for key, text in _fields(_message(value))}
            metadata[entry.get(1, b"").decode()] = entry.get(2, b"")
        elif field in (20, 25):
            raise ModelError("has training steps or functions of its own")
    if graphs != 1:
        raise ValueError("no graph")
    return metadata


def _check_graph(graph: memoryview) -> None:
    constants: set[bytes] = set()
    for field, value in _fields(graph):
        if field == 5:
            constants.add(_check_tensor(_message(value)))
        elif field == 15:
            raise ModelError("has sparse weights")
    for field, value in _fields(graph):
        if field == 1:
            _check_node(_message(value), constants)


def _check_node(node: memoryview, constants: set[bytes]) -> None:
    """Refuse what no network of this kind needs; `constants` are the tensors that do not depend on the image."""
    operator, inputs, outputs = "", list[bytes](), list[bytes]()
    for field, value in _fields(node):
        if field in (1, 2):
            (inputs if field == 1 else outputs).append(bytes(_message(value)))
        elif field == 4:
            operator = bytes(_message(value)).decode()
            if operator not in OPERATORS:
                raise ModelError(f"has the operator {operator[:40]!r}, which no network of this kind needs")
        elif field == 5:
            _check_attribute(_message(value))
        elif field == 7 and len(_message(value)):
            raise ModelError(f"has an operator of the domain {bytes(_message(value))[:40].decode()!r}")
    if inputs and constants.issuperset(filter(None, inputs)):
        if operator != "DequantizeLinear":  # of weights: as many numbers come out as go in
            raise ModelError(f"has the operator {operator!r} on constants alone")
        constants.update(outputs)


def _check_attribute(attribute: memoryview) -> None:
    for field, value in _fields(attribute):
        if field in (5, 6, 10, 11, 22, 23):
            raise ModelError("has a tensor or a graph inside an operator")
        if field in (3, 8):
            numbers = [value] if isinstance(value, int) else list(_varints(value))
            if any(MAX_ATTRIBUTE < number < 2**64 - MAX_ATTRIBUTE for number in numbers):  # negatives: 2^64 - n
                raise ModelError(f"has an operator with a number over {MAX_ATTRIBUTE}")


def _check_tensor(tensor: memoryview) -> bytes:
    """Every number of a tensor takes at least half a byte (int4) of the message that holds it; returns its name."""
    count, name = 1, b""
    for field, value in _fields(tensor):
        if field == 8:
            name = bytes(_message(value))
        elif field == 1:
            for size in [value] if isinstance(value, int) else _varints(value):
                count *= size
        elif field == 13 or (field == 14 and value != 0):
            raise ModelError("keeps weights in another file")
    if count > 2 * len(tensor):
        raise ModelError(f"claims {count} weights and holds {len(tensor)} bytes")
    return name


def _fields(message: memoryview) -> Iterator[tuple[int, _Value]]:
    """The fields of one protobuf message in order; ValueError or IndexError when it is cut short."""
    position = 0
    while position < len(message):
        key, position = _varint(message, position)
        wire_type = key & 7
        if wire_type == _VARINT:
            value, position = _varint(message, position)
            yield key >> 3, value
            continue
        if wire_type == _BYTES:
            length, position = _varint(message, position)
        elif wire_type in (_FIXED64, _FIXED32):
            length = 8 if wire_type == _FIXED64 else 4
        else:
            raise ValueError("unknown wire type")
        if position + length > len(message):
            raise ValueError("field runs past the end")
        yield key >> 3, message[position : position + length]
        position += length


def _varint(message: memoryview, position: int) -> tuple[int, int]:
    """A base-128 number of at most 64 bits, and the position after it."""
    number = 0
    for shift in range(0, 70, 7):
        byte = message[position]
        position += 1
        number |= (byte & 0x7F) << shift
        if byte < 0x80:
            return number, position
    raise ValueError("number too long")


def _varints(packed: memoryview) -> Iterator[int]:
    position = 0
    while position < len(packed):
        number, position = _varint(packed, position)
        yield number


def _message(value: _Value) -> memoryview:
    if isinstance(value, int):
        raise ValueError("number where a message belongs")
    return value
