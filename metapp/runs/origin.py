"""Where a fit's inputs were and what it ran on: what its record says beside the settings that its key is of."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch

from metapp.runs.inputs import AS_FILES_SAY, Reading
from metapp.runs.session import Options


def machine(device: torch.device) -> str:
    """What arithmetic ran on: the GPU's name, or the processor's architecture and vector instructions."""
    if device.type == "cuda":
        return str(torch.cuda.get_device_name(device))
    return f"{platform.machine()} {torch.backends.cpu.get_cpu_capability()}"


def origin_of(options: Options, inputs: Sequence[Path] = (), reading: Reading = AS_FILES_SAY) -> dict[str, Any]:
    """What `metapp rerun` needs to find what was fitted: absolute paths, as far as any were given, and the machine."""
    given: dict[str, Any] = {
        "inputs": [str(path.absolute()) for path in inputs],
        "roots": [str(path.absolute()) for path in reading.roots],
        "fov_rad": reading.fov_rad,
        "data": options.data and str(options.data.absolute()),
        "checkpoint": options.checkpoint and str(options.checkpoint.absolute()),
    }
    return {"machine": machine(options.device)} | {key: value for key, value in given.items() if value}
