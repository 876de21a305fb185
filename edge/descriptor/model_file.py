"""The network's file: read once, and given to ONNX Runtime only if its hash is known.

ONNX Runtime computes constants while it loads a model, so a file of 200 bytes can fill the memory of the computer. So
a file is used only if it ships with Lookback, or if the file NAME.sha256 beside it, which `lookback model import`
writes after its checks at the desk, has its hash. The field numbers are those of onnx.proto
(https://github.com/onnx/onnx/blob/main/onnx/onnx.proto).
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
SHIPPED = frozenset(
    {
        "fe0bd1859f485f997153dc540c2058c9b0cc70fe65ce16e446bb2e28705c2739",  # grid
        "a5913c58666435594d0258a9f6e7e5a51cb68b291f7366b735d75ca3f35a6bb4",  # xfeat
        "132447bcb7be2d820a88c8ff955a54d607bea5dedb71a39cc5331e89aa85f2c5",  # fc6
    }
)
"""The sha256 of the networks that come with Lookback."""

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
    """The bytes of a network file whose hash is known, and its description."""

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
    """Read one file whose hash is known; ModelError in one line."""
    try:
        size = path.stat().st_size
        if size > MAX_FILE_BYTES:
            raise ModelError(f"{path}: {size} bytes; a network has at most {MAX_FILE_BYTES}")
        data = path.read_bytes()
    except OSError as error:
        raise ModelError(f"{path}: cannot read the network: {error.strerror}") from None
    sha256 = hashlib.sha256(data).hexdigest()
    if sha256 not in SHIPPED and sha256 != _vouched(path):
        raise ModelError(
            f"{path}: not a network that comes with Lookback, and {hash_file(path).name} beside it does not have its"
            f" sha256, {sha256[:12]}...; copy both files again, or make them with `lookback model import`"
        )
    try:
        metadata = _metadata(memoryview(data))
    except (ValueError, IndexError):  # of the wire format: varint cut short, length past the end, not UTF-8
        raise ModelError(f"{path}: not a whole ONNX file; make it with `lookback model import`") from None
    return ModelFile(path, data, _decode_info(path, metadata, sha256))


def hash_file(path: Path) -> Path:
    """The file that has the sha256 of a network, as `sha256sum` writes it."""
    return path.with_name(f"{path.name}.sha256")


def _vouched(path: Path) -> str:
    try:
        return hash_file(path).read_text(encoding="utf-8")[:64]
    except (OSError, UnicodeDecodeError):
        return ""


def _decode_info(path: Path, metadata: dict[str, bytes], sha256: str) -> ModelInfo:
    if METADATA_KEY not in metadata:
        raise ModelError(f"{path}: no {METADATA_KEY!r} in its metadata; make it with `lookback model import`")
    try:
        info = msgspec.json.decode(metadata[METADATA_KEY], type=ModelInfo)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:  # ValidationError is a DecodeError
        raise ModelError(f"{path}: metadata {METADATA_KEY!r}: {error}") from None
    return msgspec.structs.replace(info, sha256=sha256)


def _metadata(model: memoryview) -> dict[str, bytes]:
    """The metadata_props of a ModelProto."""
    metadata: dict[str, bytes] = {}
    for field, value in _fields(model):
        if field == 14:
            entry = {key: bytes(_message(text)) for key, text in _fields(_message(value))}
            metadata[entry.get(1, b"").decode()] = entry.get(2, b"")
    return metadata


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


def _message(value: _Value) -> memoryview:
    if isinstance(value, int):
        raise ValueError("number where a message belongs")
    return value
