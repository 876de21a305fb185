"""Any ONNX network: a small one built here, against the same network run by ONNX Runtime on a prepared float image."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from edge.__main__ import main
from edge.descriptor.model_file import read_model_file
from edge.descriptor.network import Network, open_session
from edge.errors import ModelError
from sim.model_tools.onnx_graph import MEAN_RGB, STD_RGB
from sim.model_tools.onnx_import import ImageInput, import_onnx
from tests.onnx_text import onnx_of

onnx = pytest.importorskip("onnx", reason="importing models needs the extra `model`")

SIZE, CHANNELS, CLASSES = 32, 72, 80
Options = list[str]


def network(layout: str = "nchw", size: tuple[int, int] = (SIZE, SIZE), batch: int | str = "B") -> Any:
    """Convolution, ReLU (`map`), average (`pooled`), flattened as exporters do it, and `logits`."""
    random, (height, width) = np.random.default_rng(2), size
    shape = f"3, {height}, {width}" if layout == "nchw" else f"{height}, {width}, 3"
    order = [0, 1, 2, 3] if layout == "nchw" else [0, 3, 1, 2]
    # Exporters read the size of the batch from the tensor itself.
    own = " shape = Shape(pooled)  batch = Gather<axis = 0>(shape, first)  sizes = Concat<axis = 0>(batch, rest)"
    text = (
        f"small (float[{batch}, {shape}] x) => (float[{batch}, {CLASSES}] fc) {{ planes = Transpose<perm = {order}>(x)"
        " conv = Conv<strides = [3, 3], pads = [2, 2, 2, 2]>(planes, kernel, bias)  map = Relu(conv)"
        f" pooled = GlobalAveragePool(map) {'' if isinstance(batch, int) else own}"
        f" flat72 = Reshape(pooled, {'flat' if isinstance(batch, int) else 'sizes'})"
        " fc = Gemm(flat72, weight, classes) }"
    )
    floats = {
        "kernel": random.normal(0, 0.3, (CHANNELS, 3, 5, 5)),
        "bias": random.normal(0, 0.1, CHANNELS),
        "weight": random.normal(0, 1, (CHANNELS, CLASSES)),
        "classes": random.normal(0, 1, CLASSES),
    }
    whole = {"first": [0], "rest": [-1]} if batch == "B" else {"flat": [batch, CHANNELS]}
    constants = {name: np.array(value, np.int64) for name, value in whole.items()}
    return onnx_of(text, **{name: value.astype(np.float32) for name, value in floats.items()}, **constants)


@pytest.fixture
def images() -> NDArray[np.uint8]:
    coarse = np.random.default_rng(5).integers(0, 256, (3, 8, 8, 3), dtype=np.uint8)
    return coarse.repeat(4, axis=1).repeat(4, axis=2)


def imported(model: Any, wanted: ImageInput | None = None, **options: Any) -> Any:
    return import_onnx(Path("net.onnx"), model.SerializeToString(), wanted or ImageInput(), **options)


def described(found: Any, images: NDArray[np.uint8]) -> NDArray[np.float32]:
    session = open_session(found.model.SerializeToString())
    return np.concatenate([session.run(None, {"image": one[np.newaxis]})[0] for one in images])


def exact(model: Any, images: NDArray[np.uint8], tensor: str, mean: Any = MEAN_RGB, std: Any = STD_RGB) -> Any:
    """A tensor of the given network for RGB images that are prepared as its authors say; one image at a time."""
    copy = onnx.ModelProto()
    copy.CopyFrom(model)
    del copy.graph.output[:]
    copy.graph.output.append(onnx.helper.make_tensor_value_info(tensor, 1, None))
    session = open_session(copy.SerializeToString())
    prepared = ((images[..., ::-1] / 255 - mean) / std).astype(np.float32).transpose(0, 3, 1, 2)
    return np.concatenate([session.run(None, {"x": one[None]})[0] for one in np.ascontiguousarray(prepared)])


def close(found: NDArray[np.float32], wanted: NDArray[np.float32]) -> None:
    np.testing.assert_allclose(found, wanted, rtol=1e-3, atol=1e-3 * float(np.abs(wanted).max()))


NO_MEAN: tuple[float, float, float] = (0.0, 0.0, 0.0)
ONE: tuple[float, float, float] = (1.0, 1.0, 1.0)


@pytest.mark.parametrize("batch", ["B", 1])
def test_the_output_of_a_network(batch: Any, images: NDArray[np.uint8]) -> None:
    """Zeros beyond the edge: with a mean of 0 the gray that stands for nothing is exact."""
    model = network(batch=batch)
    found = imported(model, ImageInput(mean_rgb=NO_MEAN, std_rgb=ONE))
    assert (found.tap, found.dimensions, found.size) == ("fc", CLASSES, (SIZE, SIZE))
    close(described(found, images), exact(model, images, "fc", NO_MEAN, ONE))


def test_the_gray_edge_of_other_means_is_close(images: NDArray[np.uint8]) -> None:
    model = network()
    found, wanted = described(imported(model), images), exact(model, images, "fc")
    assert (found * wanted).sum() / np.linalg.norm(found) / np.linalg.norm(wanted) > 0.998


def test_channels_and_layout(images: NDArray[np.uint8]) -> None:
    plain = ImageInput(mean_rgb=NO_MEAN, std_rgb=ONE)
    wanted = described(imported(network(), plain), images)
    close(described(imported(network("nhwc"), plain), images), wanted)
    swapped = imported(network(), ImageInput(mean_rgb=NO_MEAN, std_rgb=ONE, channels="BGR"))
    close(described(swapped, np.ascontiguousarray(images[..., ::-1])), wanted)
    assert not np.allclose(described(swapped, images), wanted)


@pytest.mark.parametrize("pool", [(1, 1), (2, 2), (4, 4), (3, 2)])
def test_average_over_a_grid(pool: tuple[int, int], images: NDArray[np.uint8]) -> None:
    model, plain = network(), ImageInput(mean_rgb=NO_MEAN, std_rgb=ONE)
    found = imported(model, plain, tap="map", pool=pool)
    maps = exact(model, images, "map", NO_MEAN, ONE)
    side = maps.shape[2]
    cells = [
        maps[
            :,
            :,
            side * row // pool[0] : -(-side * (row + 1) // pool[0]),
            side * col // pool[1] : -(-side * (col + 1) // pool[1]),
        ]
        for row in range(pool[0])
        for col in range(pool[1])
    ]
    wanted = np.stack([cell.mean(axis=(2, 3)) for cell in cells], axis=2).reshape(len(images), -1)
    assert found.dimensions == CHANNELS * len(cells)
    close(described(found, images), wanted)


def test_the_outer_columns_of_a_grid_are_regions_from_the_outside_in(images: NDArray[np.uint8], tmp_path: Path) -> None:
    model, plain = network(), ImageInput(mean_rgb=NO_MEAN, std_rgb=ONE)
    found = imported(model, plain, tap="map", pool=(2, 5), columns=2)
    maps = exact(model, images, "map", NO_MEAN, ONE)
    side, rows, of_grid = maps.shape[2], 2, 5
    down = [(side * row // rows, -(-side * (row + 1) // rows)) for row in range(rows)]
    across = [(side * col // of_grid, -(-side * (col + 1) // of_grid)) for col in range(of_grid)]
    cells = {at: maps[:, :, slice(*down[at[0]]), slice(*across[at[1]])].mean(axis=(2, 3)) for at in np.ndindex(2, 5)}
    regions = [[cells[row, col] for row in range(rows) for col in region] for region in ((0, 1), (4, 3))]
    wanted = np.stack([np.stack(region, axis=2) for region in regions], axis=1).reshape(len(images), 2, -1)
    assert (found.dimensions, found.columns) == (CHANNELS * 2 * 2, ((0, 1), (4, 3)))
    close(described(found, images), wanted)


@pytest.mark.parametrize(("pool", "columns"), [((2, 5), 3), ((2, 5), 0), (None, 1)])
def test_columns_that_a_grid_does_not_have(pool: tuple[int, int] | None, columns: int) -> None:
    with pytest.raises(ModelError, match=rf"--columns {columns}: .* can be a region"):
        imported(network(), tap="map", pool=pool, columns=columns)


def test_a_map_without_a_grid_is_flattened(images: NDArray[np.uint8]) -> None:
    model, plain = network(), ImageInput(mean_rgb=NO_MEAN, std_rgb=ONE)
    found = imported(model, plain, tap="map")
    close(described(found, images), exact(model, images, "map", NO_MEAN, ONE).reshape(3, -1))


def test_an_open_size_is_the_one_that_is_asked_for(images: NDArray[np.uint8]) -> None:
    model = network()
    for axis in (2, 3):
        model.graph.input[0].type.tensor_type.shape.dim[axis].dim_param = f"side{axis}"
    assert imported(model, ImageInput(size=(48, 64))).size == (48, 64)
    assert imported(model).size == (224, 224)


def test_a_network_that_works_only_with_a_batch_of_one(images: NDArray[np.uint8], tmp_path: Path) -> None:
    """A constant of one image is joined to its features, as a class token is."""
    model = network()
    token = onnx.numpy_helper.from_array(np.ones((1, 8), np.float32), "token")
    model.graph.initializer.append(token)
    model.graph.node.append(onnx.helper.make_node("Concat", ["flat72", "token"], ["joined"], axis=1))
    found = imported(model, ImageInput(mean_rgb=NO_MEAN, std_rgb=ONE), tap="joined")
    assert found.model.graph.input[0].type.tensor_type.shape.dim[0].dim_value == 1
    file = tmp_path / "net.onnx"
    file.write_bytes(model.SerializeToString())
    out = tmp_path / "one.onnx"
    options = ["--tap", "joined", "--float-only", "--mean", "0", "0", "0", "--std", "1", "1", "1"]
    assert main(["model", "import", str(file), "-o", str(out), *options]) == 0
    close(Network.load(out).describe(images)[:, :72], exact(model, images, "flat72", NO_MEAN, ONE))


def edited(change: Callable[[Any], None]) -> Any:
    model = network()
    change(model)
    return model


def second_input(model: Any) -> None:
    model.graph.input.append(onnx.helper.make_tensor_value_info("mask", 1, ["B", 4]))


def of_bytes(model: Any) -> None:
    model.graph.input[0].type.tensor_type.elem_type = onnx.TensorProto.UINT8


def four_channels(model: Any) -> None:
    model.graph.input[0].type.tensor_type.shape.dim[1].dim_value = 4


def unknown_operator(model: Any) -> None:
    model.graph.node.append(onnx.helper.make_node("TopK", ["fc", "k"], ["best", "indices"]))
    model.graph.initializer.append(onnx.numpy_helper.from_array(np.array([70], np.int64), "k"))


def of_no_operator(model: Any) -> None:
    model.graph.node.append(onnx.helper.make_node("Nonsense", ["fc"], ["strange"]))


@pytest.mark.parametrize(
    ("change", "options", "reason"),
    [
        (None, {"tap": "mop"}, r"has no tensor 'mop'; near it is 'map'"),
        (None, {"tap": "flat72", "pool": (2, 2)}, r"tensor 'flat72' has the shape \(B, 72\); only a feature map"),
        (None, {"tap": "map", "pool": (4, 40)}, r"tensor 'map' has the shape \(B, 72, 11, 11\), which is smaller than"),
        (None, {"tap": "map", "pool": (11, 11), "wanted": ImageInput(size=(99, 99))}, r"input 'x' has the fixed shape"),
        (None, {"tap": "shape"}, r"tensor 'shape' |ONNX Runtime rejects it"),
        (second_input, {}, r"has 2 inputs \(x, mask\); a network with one image"),
        (of_bytes, {}, r"input 'x' is uint8 \(\?, 3, 32, 32\); float of 4 dimensions is needed"),
        (four_channels, {}, r"input 'x' has the shape \(\?, 4, 32, 32\), with no axis of 3 channels; give --layout"),
        (unknown_operator, {"tap": "best"}, r"tensor 'best' is computed by TopK, which Lookback does not run"),
        (of_no_operator, {"tap": "strange"}, r"ONNX Runtime rejects it with an image of 32x32"),
    ],
)
def test_what_cannot_be_used_is_said_in_one_line(change: Any, options: dict[str, Any], reason: str) -> None:
    model = edited(change) if change else network()
    with pytest.raises(ModelError, match=reason) as caught:
        imported(model, **options)
    assert str(caught.value).startswith("net.onnx: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("data", [b"", b"hello", bytes(64), b"\x08\x08"])
def test_other_files_are_refused(data: bytes) -> None:
    with pytest.raises(ModelError, match=r"^net\.onnx: not (a whole ONNX file|an ONNX network)"):
        import_onnx(Path("net.onnx"), data, ImageInput())


def test_too_few_and_too_many_dimensions() -> None:
    model = network(size=(96, 96))
    with pytest.raises(
        ModelError, match=r"tensor 'map' .* gives 73728 dimensions; 64 to 32768 .*choose another --pool"
    ):
        imported(model, tap="map")
    narrow = network()
    for one in narrow.graph.initializer:
        if one.name in ("weight", "classes"):
            some = onnx.numpy_helper.to_array(one)[..., :10]
            one.CopyFrom(onnx.numpy_helper.from_array(np.ascontiguousarray(some), one.name))
    with pytest.raises(
        ModelError, match=r"tensor 'fc' has the shape \(B, 10\), which gives 10 dimensions; 64 to 32768"
    ):
        imported(narrow)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "small.onnx"
    path.write_bytes(network().SerializeToString())
    return path


def test_from_the_file_to_recognized_places(
    file: Path, tmp_path: Path, write_traverse: Callable[..., Path], capsys: pytest.CaptureFixture[str]
) -> None:
    """Import, info, verify, a map, and a replay."""
    feed, again = write_traverse(tmp_path / "feed"), write_traverse(tmp_path / "again", noise=4.0)
    model = tmp_path / "model"
    options = ["--tap", "flat72", "--calibrate", str(feed), "--license", "CC0", "--float"]
    assert main(["model", "import", str(file), "-o", str(model), *options]) == 0
    names = [f"network_{kind}.onnx{end}" for kind in ("float32", "int8") for end in ("", ".sha256")]
    assert sorted(one.name for one in model.iterdir()) == names
    assert "int8 with 0 layers in float: cosine to float after NSD " in capsys.readouterr().out
    opened = Network.load(model)
    assert (opened.info.name, opened.info.output, opened.info.precision) == ("small", "flat72", "int8")
    assert (opened.info.size, opened.info.dimensions) == ((SIZE, SIZE), CHANNELS)

    weights = str(model / "network_float32.onnx")
    assert main(["model", "verify", str(model), str(again), "--weights", weights]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "passed"
    config = tmp_path / "lookback.toml"
    config.write_text(f'[descriptor]\nmodel = "{model}"\n[map]\npath = "{tmp_path / "map"}"\n[sequence]\nlength = 10\n')
    assert main(["map", "build", str(feed), "-o", str(tmp_path / "map"), "--config", str(config)]) == 0
    assert main(["map", "info", str(tmp_path / "map")]) == 0
    assert "model     small, tap flat72, sha256 " in capsys.readouterr().out
    events = tmp_path / "events.jsonl"
    assert main(["replay", str(again), "--map", str(tmp_path / "map"), "--config", str(config), "-o", str(events)]) == 0
    said = [json.loads(line) for line in events.read_text().splitlines()]
    assert said


@pytest.mark.parametrize(("columns", "output"), [([], "map 2x2"), (["--columns", "1"], "map 2x2 0 1")])
def test_a_float_network_of_a_grid_recognizes_places(
    columns: Options, output: str, file: Path, tmp_path: Path, write_traverse: Callable[..., Path]
) -> None:
    feed, model = write_traverse(tmp_path / "feed"), tmp_path / "model.onnx"
    options = ["--tap", "map", "--pool", "2x2", *columns, "--float-only"]
    assert main(["model", "import", str(file), "-o", str(model), *options]) == 0
    assert read_model_file(model).info.output == output
    assert Network.load(model).describe(np.zeros((3, SIZE, SIZE, 3), np.uint8)).shape[0] == (6 if columns else 3)
    config = tmp_path / "lookback.toml"
    config.write_text(f'[descriptor]\nmodel = "{model}"\n[map]\npath = "{tmp_path / "map"}"\n[sequence]\nlength = 10\n')
    assert main(["map", "build", str(feed), "-o", str(tmp_path / "map"), "--config", str(config)]) == 0
    events = tmp_path / "events.jsonl"
    assert main(["replay", str(feed), "--map", str(tmp_path / "map"), "--config", str(config), "-o", str(events)]) == 0
    assert events.read_text()


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ([], "model import: give feeds to --calibrate, or --float-only"),
        (["--float-only", "--pool", "4y4"], "--pool: '4y4' is not two numbers such as 4x4"),
        (["--float-only", "--size", "0"], "--size: '0' is not two numbers"),
        (["--float-only", "--std", "0", "1", "1"], "--white and --std: need numbers above 0"),
    ],
)
def test_options_that_cannot_be_used(
    options: Options, reason: str, file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["model", "import", str(file), "-o", str(tmp_path / "out"), *options]) != 0
    assert reason in capsys.readouterr().err


def test_verify_with_another_float_network(file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, tap in (("one", "flat72"), ("two", "fc")):
        out = tmp_path / f"{name}.onnx"
        assert main(["model", "import", str(file), "-o", str(out), "--tap", tap, "--float-only"]) == 0
    info = read_model_file(tmp_path / "one.onnx").info
    assert msgspec.structs.asdict(info)["precision"] == "float32"
    assert main(["model", "verify", str(tmp_path / "one.onnx"), str(tmp_path), "--weights", str(tmp_path / "two.onnx")])
    assert "two.onnx: not the float network of" in capsys.readouterr().err
