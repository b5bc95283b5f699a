"""`metapp doctor`: a report on the installation."""

from __future__ import annotations

import os
import shutil
import subprocess
import sysconfig

from metapp.cli.console import out, print_json
from metapp.cli.options import Json
from metapp.registry import SHIPPED, WITHOUT, registry
from metapp.storage import Document

PACKAGES = (
    "metapp",
    "torch",
    "numpy",
    "scipy",
    "mitsuba",
    "OpenImageIO",
    "colour-science",
    "safetensors",
    "typer",
    "rich",
)


def command(
    json: Json = False,
) -> None:
    """Print the installation: versions, device, compiler, cache, shipped checkpoints, VGG weights, libLLVM."""
    subjects = examine()
    if json:
        print_json(subjects)
        return
    for name, value in subjects.items():
        told, after = (": ", "; ") if name == "checkpoints" else (" ", ", ")  # these are lists
        text = after.join(f"{key}{told}{item}" for key, item in value.items()) if isinstance(value, dict) else value
        out().print(f"{name:<11} {text}", soft_wrap=True)


def examine() -> Document:
    """The lines of `doctor`, by subject."""
    import torch

    from metapp.names import app_names
    from metapp.runs.inputs.embedded import embedded_exists
    from metapp.storage.cache import cache_folder
    from metapp.storage.shipped import shipped_names

    shipped = {key: names for app in app_names() for key, names in shipped_names(app).items()}
    return {
        "versions": {name: _version(name) for name in PACKAGES},
        "extensions": ", ".join(_extensions()),
        "device": torch.cuda.get_device_name() if torch.cuda.is_available() else f"CPU, {os.cpu_count()} cores",
        "compiler": _compiler(),
        "cache": str(cache_folder()),
        "data": {app: "made" if embedded_exists(app) else "made on first use" for app in app_names()},
        "checkpoints": {key: ", ".join(names) or "none" for key, names in shipped.items()},
        "VGG": _vgg(),
        "libLLVM": _llvm(),
    }


def _extensions() -> list[str]:
    """Extensions by name, with the package of those that do not ship, and those that are left out."""
    extensions = registry().extensions.items()
    names = [name if package == SHIPPED else f"{name} of {package}" for name, package in extensions]
    names += [f"{name} (left out: {reason})" for name, reason in registry().problems.items()]
    without = os.environ.get(WITHOUT, "")
    return names + [f"left out by {WITHOUT}: {without}"] * bool(without)


def _compiler() -> str:
    """The compiler for torch.compile, if it takes Python's headers and OpenMP: a probe of much less than a second."""
    name = next(filter(shutil.which, ("g++", "clang++")), "")
    probe = "#include <Python.h>\n#include <omp.h>\nint main() { return omp_get_max_threads() < 1; }\n"
    options = ["-x", "c++", "-fopenmp", "-fsyntax-only", f"-I{sysconfig.get_path('include')}", "-"]
    if name and subprocess.run([name, *options], input=probe, text=True, capture_output=True).returncode == 0:
        return f"{name}, with Python's headers and OpenMP"
    return "none that works: training is half as fast; install g++ and python3-dev"


def _version(package: str) -> str:
    from importlib import metadata  # here: it takes as long to import as all commands

    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "missing"


def _vgg() -> str:
    from safetensors import SafetensorError

    from metapp.appearance.features import weights_path
    from metapp.storage.files import opened_tensors

    if not weights_path().is_file():
        return "not fetched; textures and svbrdf_stationary need it; get it: metapp data vgg"
    try:
        with opened_tensors(weights_path()) as file:
            return f"from {(file.metadata() or {}).get('source', 'unknown')}"
    except (OSError, SafetensorError):
        return "damaged: what is fitted to pictures fails; fetch it again: metapp data vgg"


def _llvm() -> str:
    """The library that scenes are rendered with."""
    from metapp.rendering.variant import find_llvm

    try:
        return str(find_llvm())
    except ValueError as error:
        return str(error).removeprefix("libLLVM: ")
