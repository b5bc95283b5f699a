"""Surroundings that figures depend on beside settings: device, precision, versions; folders to write to."""

from __future__ import annotations

import platform
import tempfile
from importlib import metadata
from pathlib import Path

import torch

from metapp.learning.app import App
from metapp.options import BadOption
from metapp.storage.text import meant


def threads_of(app: App) -> int | None:
    """The threads of an application's fits: 1 where threads only wait for each other, else None, all there are."""
    return 1 if app.single_threaded else None


def find_device(name: str, app: App) -> torch.device:
    """The device; auto is CUDA where there is one, but the CPU where the application is single-threaded."""
    if name not in ("auto", "cpu", "cuda"):
        raise BadOption(f"--device '{name}': expected auto, cpu or cuda.{meant(name, ('auto', 'cpu', 'cuda'))}")
    if name == "cuda" and not torch.cuda.is_available():
        raise ValueError("--device cuda: PyTorch finds no CUDA device; use --device cpu or install a CUDA build.")
    automatic = "cuda" if torch.cuda.is_available() and not app.single_threaded else "cpu"
    return torch.device(automatic if name == "auto" else name)


def versions() -> dict[str, str]:
    """The versions that a figure depends on."""
    return {
        "metapp": metadata.version("metapp"),
        "torch": str(torch.__version__),
        "python": platform.python_version(),
    }


def precision_of(app: App, device: torch.device, steps: int = 1) -> dict[str, str]:
    """The precision of so many steps as records and headers of checkpoints state it; {} for float32."""
    precision = app.precision(device) if steps else ""
    return {"precision": precision} if precision else {}


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
