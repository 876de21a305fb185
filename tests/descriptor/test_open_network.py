"""The network on its provider: compared with the CPU, and named in the map's header."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from edge.config import DescriptorConfig, SamplingConfig
from edge.descriptor.model_file import ModelFile, fc6_folder, read_model_file
from edge.descriptor.network import Network
from edge.descriptor.open_network import check_agreement, open_network
from edge.errors import ConfigError, ModelError
from edge.feed import read_feed
from edge.reference_map import open_map
from sim.maps.command import build_map


def test_a_provider_that_is_not_there_is_named_with_those_that_are() -> None:
    with pytest.raises(
        ConfigError, match=r'^\[descriptor\] provider: "tensorrt" is not in this build .*; there is "cpu"'
    ):
        open_network(DescriptorConfig(provider="tensorrt"))


def test_a_provider_that_agrees_is_named_by_the_map(tmp_path: Path, write_traverse: Callable[..., Path]) -> None:
    """ONNX Runtime's own CPU provider by its full name takes the way that an accelerator takes."""
    network = open_network(DescriptorConfig(provider="CPUExecutionProvider"))
    feed = read_feed(write_traverse(tmp_path / "feed", range(4)))
    build_map([feed], tmp_path / "map", DescriptorConfig(), SamplingConfig(), network=network)
    assert open_map(tmp_path / "map").header.model.provider == "CPUExecutionProvider"
    build_map([feed], tmp_path / "other", DescriptorConfig(), SamplingConfig(), network=Network.load())
    assert b"provider" not in (tmp_path / "other" / "map.json").read_bytes()  # as before there were providers
    assert open_map(tmp_path / "other").header.model.provider == "cpu"


def test_a_provider_that_disagrees_is_refused_in_one_line() -> None:
    """Scales of the last layer that are permuted: plausible numbers, and other descriptors."""
    onnx = pytest.importorskip("onnx", reason="needs the extra `model`")
    file = read_model_file(fc6_folder() / "fc6_int8.onnx")
    model = onnx.load_model_from_string(file.data)
    scales = next(one for one in model.graph.initializer if one.name == "classifier.1.weight_scale")
    values = onnx.numpy_helper.to_array(scales)
    scales.CopyFrom(onnx.numpy_helper.from_array(np.random.default_rng(0).permutation(values), scales.name))
    bias = next(one for one in model.graph.initializer if one.name.startswith("classifier.1.bias"))
    bias.CopyFrom(onnx.numpy_helper.from_array(np.zeros_like(onnx.numpy_helper.to_array(bias)), bias.name))
    other = Network(ModelFile(file.path, model.SerializeToString(), file.info))
    with pytest.raises(
        ModelError, match=r"differ from those of the CPU: cosine after NSD 0\.\d+, and 0\.995 is needed"
    ):
        check_agreement(Network(file), other)
