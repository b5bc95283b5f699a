"""Surroundings that figures depend on beside settings: device, threads, precision, versions; folders to write to."""

from __future__ import annotations

import contextlib
import platform
import tempfile
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from typing import Any

import torch

from metapp.learning.app import App

# their precision may be lowered, as by torch.set_float32_matmul_precision
_MKLDNN: Any = torch.backends.mkldnn  # whose members are made at its import
_PRODUCTS = (_MKLDNN.matmul, _MKLDNN.conv, torch.backends.cuda.matmul)


def find_device(name: str, app: App) -> torch.device:
    """The device; auto is CUDA if there is one, but the CPU if the application is single-threaded."""
    if name == "cuda" and not torch.cuda.is_available():
        raise ValueError("--device cuda: PyTorch finds no CUDA device; use --device cpu or install a CUDA build.")
    automatic = "cuda" if torch.cuda.is_available() and not app.single_threaded else "cpu"
    return torch.device(automatic if name == "auto" else name)


def software_versions() -> dict[str, str]:
    """The versions that a figure depends on."""
    return {
        "metapp": metadata.version("metapp"),
        "torch": str(torch.__version__),
        "python": platform.python_version(),
    }


def make_folder(folder: Path) -> None:
    """Make a folder to write to, before any work is done.

    Raises:
        ValueError: it cannot be made or written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):  # nameless, as other runs may write there, too
            pass
    except OSError as error:
        raise ValueError(f"--out {folder}: cannot be written to ({error.strerror}); choose another folder.") from None


@contextlib.contextmanager
def torch_defaults(*, single: bool) -> Iterator[None]:
    """Have torch work with one thread or with all it has, and by its own defaults; afterwards by the program's.

    Autocast, default dtype and device, precision of products and modes without gradients are put aside.

    Threads, dtype and precision are torch's for the whole process. Python threads that fit at the same time therefore
    share them: a fit may work with the count of another, by which figures of several threads differ by rounding, and
    the last one sets those that stay. A process that was forked after work by several threads waits without end
    in torch: start processes by `spawn` or `forkserver`, or set one thread before.

    Args:
        single: whether threads would only wait for each other, as of `App.single_threaded`.
    """
    count_around, dtype = torch.get_num_threads(), torch.get_default_dtype()
    precisions = [product.fp32_precision for product in _PRODUCTS]
    with contextlib.ExitStack() as aside:
        aside.callback(_set, count_around, dtype, precisions)
        _set(1 if single else count_around, torch.float32, ["ieee"] * len(_PRODUCTS))
        for kind in ("cpu", "cuda"):
            if torch.is_autocast_enabled(kind):
                aside.enter_context(torch.autocast(kind, enabled=False))
        if torch.get_default_device().type != "cpu":
            aside.enter_context(torch.device("cpu"))
        aside.enter_context(torch.inference_mode(False))
        aside.enter_context(torch.enable_grad())
        yield


def _set(count: int, dtype: torch.dtype, precisions: list[str]) -> None:
    torch.set_num_threads(count)
    torch.set_default_dtype(dtype)
    for product, precision in zip(_PRODUCTS, precisions, strict=True):
        product.fp32_precision = "none"  # as that of all products
        if product.fp32_precision != precision:
            product.fp32_precision = precision
