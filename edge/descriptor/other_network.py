"""A network that gives other things than descriptors, opened as any is: read, hashed, checked, and run on the CPU."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edge.descriptor.model_file import read_model_file, resolve_model
from edge.descriptor.network import IMAGE, open_session
from edge.errors import ModelError

Run = Callable[[NDArray[np.uint8]], list[NDArray[np.float32]]]


def open_graph(path: Path, outputs: tuple[str, ...]) -> Run:
    """See `edge.descriptor.open_graph`."""
    file = read_model_file(resolve_model(path))
    session = open_session(file.data)
    given = [(tensor.name, tensor.type) for tensor in session.get_inputs()]
    found = tuple(tensor.name for tensor in session.get_outputs())
    if given != [(IMAGE, "tensor(uint8)")] or found != outputs:
        raise ModelError(f"{file.path}: gives {', '.join(found)}; {', '.join(outputs)} are needed")
    return lambda pictures: list(session.run(outputs, {IMAGE: pictures}))
