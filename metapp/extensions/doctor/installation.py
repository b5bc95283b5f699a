"""The installation: versions, device, compiler, cache, checkpoints, weights of VGG, libLLVM.

Everything is examined, nothing changed or fetched.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sysconfig
from importlib import metadata

import torch
from safetensors import SafetensorError

from metapp.appearance.features import vgg_weights_path
from metapp.names import app_names
from metapp.registry import METAPP_PACKAGE, WITHOUT_VARIABLE, registry
from metapp.rendering.variant import find_llvm
from metapp.runs.inputs.embedded import has_embedded_tests
from metapp.storage import Document
from metapp.storage.cache_folders import cache_folder
from metapp.storage.files import open_tensors
from metapp.storage.shipped_checkpoints import shipped_checkpoint_names

REPORTED_PACKAGES = (
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


def examine_installation() -> Document:
    """Return what is installed, and what it can use, by subject: a text, or texts by name."""
    shipped = {key: names for app in app_names() for key, names in shipped_checkpoint_names(app).items()}
    return {
        "versions": {name: _read_version(name) for name in REPORTED_PACKAGES},
        "extensions": ", ".join(_list_extensions()),
        "device": torch.cuda.get_device_name() if torch.cuda.is_available() else f"CPU, {os.cpu_count()} cores",
        "compiler": _find_compiler(),
        "cache": str(cache_folder()),
        "data": {app: "made" if has_embedded_tests(app) else "made on first use" for app in app_names()},
        "checkpoints": {key: ", ".join(names) or "none" for key, names in shipped.items()},
        "VGG": _describe_vgg(),
        "libLLVM": _describe_llvm(),
    }


def _list_extensions() -> list[str]:
    """Return the names of extensions, with the package of those that do not ship, and those that are left out."""
    extensions = registry().extensions.items()
    names = [name if package == METAPP_PACKAGE else f"{name} of {package}" for name, package in extensions]
    names += [f"{name} (left out: {reason})" for name, reason in registry().problems.items()]
    left_out = os.environ.get(WITHOUT_VARIABLE, "")
    return names + [f"left out by {WITHOUT_VARIABLE}: {left_out}"] * bool(left_out)


def _find_compiler() -> str:
    """Return the compiler for torch.compile, if it finds Python's headers and OpenMP, or a remedy."""
    name = next(filter(shutil.which, ("g++", "clang++")), "")
    probe = "#include <Python.h>\n#include <omp.h>\nint main() { return omp_get_max_threads() < 1; }\n"
    options = ["-x", "c++", "-fopenmp", "-fsyntax-only", f"-I{sysconfig.get_path('include')}", "-"]
    if name and subprocess.run([name, *options], input=probe, text=True, capture_output=True).returncode == 0:
        return f"{name}, with Python's headers and OpenMP"
    return "none that works: training is half as fast; install g++ and python3-dev"


def _read_version(package: str) -> str:
    """Return the version of a package, or that it is missing."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "missing"


def _describe_vgg() -> str:
    """Return where the weights of VGG come from, or what to do without them."""
    if not vgg_weights_path().is_file():
        return "not fetched; textures and svbrdf_stationary need it; get it: metapp data vgg"
    try:
        with open_tensors(vgg_weights_path()) as file:
            return f"from {(file.metadata() or {}).get('source', 'unknown')}"
    except (OSError, SafetensorError):
        return "damaged: fits to pictures fail; fetch it again: metapp data vgg"


def _describe_llvm() -> str:
    """Return the library that scenes are rendered with, or what is wrong with the libraries that were found."""
    try:
        return str(find_llvm())
    except ValueError as error:
        return str(error).removeprefix("libLLVM: ")
