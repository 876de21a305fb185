"""Whole networks of PyTorch, by its own exporter."""

from __future__ import annotations

import logging
import tempfile
import warnings
import zipfile
from pathlib import Path

from edge.errors import ModelError
from sim.output import needing


def export_onnx(path: Path, size: tuple[int, int]) -> bytes:
    """A TorchScript file (.pt) or an exported program (.pt2) as an ONNX file. ModelError names the file.

    PyTorch runs what is in the file, so it must be one that you trust.
    """
    with needing(f"{path}:", "torch", ModelError):
        import torch
    if not zipfile.is_zipfile(path):
        raise ModelError(f"{path}: not a whole file of TorchScript or torch.export")
    image = torch.zeros(2, 3, *size)
    logging.disable(logging.WARNING)  # its exporters report each of their steps
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        file = Path(folder) / "network.onnx"
        try:
            if path.suffix == ".pt2":
                torch.onnx.export(torch.export.load(path), f=file, external_data=False, verbose=False)
            else:
                network = torch.jit.load(path, map_location="cpu").eval()
                names = {"input_names": ["image"], "output_names": ["output"]}
                axes = {"image": {0: "B"}, "output": {0: "B"}}
                torch.onnx.export(network, (image,), file, dynamic_axes=axes, dynamo=False, opset_version=17, **names)
            return file.read_bytes()
        except Exception as error:  # PyTorch's exporter raises nearly anything
            reason = (str(error) or type(error).__name__).splitlines()[0]
            raise ModelError(f"{path}: PyTorch cannot export it: {reason[:300]}") from None
        finally:
            logging.disable(logging.NOTSET)
