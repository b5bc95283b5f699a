"""The surroundings of a run: device, threads, precision and versions, which figures depend on, and folders to write to.

A program that calls metapp has settings of torch of its own; while metapp works, torch's defaults hold.
"""

from __future__ import annotations

import contextlib
import platform
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from typing import Any

import torch

from metapp.learning.app import App
from metapp.storage.files import make_writable_folder

_MKLDNN: Any = torch.backends.mkldnn  # Any: its members are made when it is imported, which mypy does not see
# Products whose precision a program may have lowered, as torch.set_float32_matmul_precision does
_PRODUCTS = (_MKLDNN.matmul, _MKLDNN.conv, torch.backends.cuda.matmul)


def find_device(name: str, app: App) -> torch.device:
    """Return the device of a name; "auto" is CUDA if there is one, but the CPU for an application with small tensors.

    Raises:
        ValueError: the name is "cuda", and PyTorch finds no such device.
    """
    if name == "cuda" and not torch.cuda.is_available():
        raise ValueError("--device cuda: PyTorch finds no CUDA device; use --device cpu or install a CUDA build.")
    automatic = "cuda" if torch.cuda.is_available() and not app.small_tensors else "cpu"
    return torch.device(automatic if name == "auto" else name)


def software_versions() -> dict[str, str]:
    """Return the versions of metapp, torch and Python, which figures depend on, by name."""
    return {
        "metapp": metadata.version("metapp"),
        "torch": str(torch.__version__),
        "python": platform.python_version(),
    }


def make_folder(folder: Path) -> None:
    """Make a folder and test that it can be written to, before any work is done.

    Raises:
        ValueError: it cannot be made or written to.
    """
    try:
        make_writable_folder(folder)
    except OSError as error:
        raise ValueError(f"--out {folder}: cannot be written to ({error.strerror}); choose another folder.") from None


@contextlib.contextmanager
def torch_defaults(*, single: bool) -> Iterator[None]:
    """Let torch work by its own defaults, with one thread or with all, and restore the program's settings at the end.

    Autocast, the default dtype and device, the precision of products, and modes without gradients are put aside.

    Threads, dtype and precision are torch's for the whole process. Python threads that fit at the same time therefore
    share them: a fit may work with another fit's number of threads, by which figures differ by rounding, and the last
    fit to end decides which settings stay. A process that was forked after several threads have worked waits in torch
    without end: start processes by `spawn` or `forkserver`, or set one thread before.

    Args:
        single: whether to work with one thread, because the tensors are so small that threads would only wait for each
            other (`App.small_tensors`).
    """
    thread_count, dtype = torch.get_num_threads(), torch.get_default_dtype()
    precisions = [product.fp32_precision for product in _PRODUCTS]
    with contextlib.ExitStack() as stack:
        stack.callback(_set_torch, thread_count, dtype, precisions)
        _set_torch(1 if single else thread_count, torch.float32, ["ieee"] * len(_PRODUCTS))
        for device_type in ("cpu", "cuda"):
            if torch.is_autocast_enabled(device_type):
                stack.enter_context(torch.autocast(device_type, enabled=False))
        if torch.get_default_device().type != "cpu":
            stack.enter_context(torch.device("cpu"))
        stack.enter_context(torch.inference_mode(False))
        stack.enter_context(torch.enable_grad())
        yield


def _set_torch(thread_count: int, dtype: torch.dtype, precisions: list[str]) -> None:
    """Set the number of threads, the default dtype and the precision of each kind of product."""
    torch.set_num_threads(thread_count)
    torch.set_default_dtype(dtype)
    for product, precision in zip(_PRODUCTS, precisions, strict=True):
        product.fp32_precision = "none"  # "none" stands for the precision of all products together
        if product.fp32_precision != precision:
            product.fp32_precision = precision
