"""The name of this machine: processor, memory, and the versions of what computes."""

from __future__ import annotations

import platform
from importlib.metadata import version
from pathlib import Path

import numkong
import numpy as np


def machine_name() -> str:
    """Processor, cores, memory, system and the versions of the kernels in use."""
    cpu = platform.processor() or platform.machine()
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith(("model name", "Model")):
            cpu = line.partition(":")[2].strip()
            break
    memory_kb = int(Path("/proc/meminfo").read_text().split()[1])
    cores = len([line for line in Path("/proc/cpuinfo").read_text().splitlines() if line.startswith("processor")])
    kernels = [name for name, on in numkong.get_capabilities().items() if on and name != "serial"]
    return (
        f"{cpu}, {cores} cores, {memory_kb / 2**20:.0f} GiB, {platform.system()} {platform.machine()}, Python"
        f" {platform.python_version()}, NumPy {np.__version__}, ONNX Runtime {version('onnxruntime')}, numkong for"
        f" {', '.join(kernels) or 'any processor'}"
    )
