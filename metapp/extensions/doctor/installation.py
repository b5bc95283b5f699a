"""The installation: versions, device, compiler, cache, checkpoints, weights of VGG, libLLVM, optional packages.

Everything is examined, and nothing is fetched or changed, except that the cache folder is made.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sysconfig
from collections.abc import Callable
from importlib import metadata, util

import torch
from safetensors import SafetensorError

from metapp.appearance.features import vgg_weights_path
from metapp.registry import METAPP_PACKAGE, WITHOUT_VARIABLE, registry
from metapp.rendering.variant import find_llvm
from metapp.runs.data_sets.embedded import has_embedded_tests
from metapp.storage import Document
from metapp.storage.cache_folders import make_cache_folder
from metapp.storage.checkpoint_files import read_headers
from metapp.storage.files import open_tensors
from metapp.storage.shipped_checkpoints import shipped_checkpoints

MISSING = "missing"  # in place of the version of a package that is not installed
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


# the extras of the package that commands need: a module that each installs, and what is not possible without it
EXTRAS = {
    "capture": ("cv2", "metapp data rectify, and photos of a mirror ball at several exposures"),
    "export": ("pxr", "--export usd"),
    "heic": ("pillow_heif", "HEIC photos"),
    "nbrdf": ("h5py", "NBRDF networks in .h5 files"),
}
FAILURES_KEY = "fails"  # key of the names of subjects that fail


def examine_installation() -> Document:
    """Return what is installed, and what it can use, by subject: a text, or texts by name.

    The last subject, "fails", lists the names of the subjects for which some commands fail. What a user adds where it
    is wanted does not count among these: extras of the package, a compiler, the weights of VGG.
    """
    shipped = {app: shipped_checkpoints(app) for app in sorted(registry().applications)}
    versions = {name: _read_version(name) for name in REPORTED_PACKAGES}
    failures = ["versions"] * (MISSING in versions.values()) + ["extensions"] * bool(registry().problems)
    failures += ["checkpoints"] * (not all(shipped.values()))

    def describe(subject: str, describe_subject: Callable[[], object]) -> str:
        try:
            return str(describe_subject())
        except ValueError as error:
            failures.append(subject)
            return str(error).removeprefix(f"{subject}: ")

    return {
        "versions": versions,
        "extensions": ", ".join(_list_extensions()),
        "device": torch.cuda.get_device_name() if torch.cuda.is_available() else f"CPU, {os.cpu_count()} cores",
        "compiler": _find_compiler(),
        "cache": describe("cache", make_cache_folder),
        "data": {
            name: "made" if has_embedded_tests(application) else "made on first use"
            for name, application in sorted(registry().applications.items())
        },
        "checkpoints": {
            f"{app} {path.stem}": ", ".join(read_headers(path)) for app, paths in shipped.items() for path in paths
        },
        "VGG": describe("VGG", _describe_vgg),
        "libLLVM": describe("libLLVM", find_llvm),
        "extras": {extra: _describe_extra(extra) for extra in EXTRAS},
        FAILURES_KEY: failures,
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
        return MISSING


def _describe_extra(extra: str) -> str:
    """Return whether an extra of the package is installed, and if not, what needs it and how to install it."""
    module, use = EXTRAS[extra]
    return "installed" if util.find_spec(module) else f'{MISSING}, for {use}: pip install "metapp[{extra}]"'


def _describe_vgg() -> str:
    """Return where the weights of VGG come from, or what fetches them.

    Raises:
        ValueError: the weights are damaged; the message says what to do.
    """
    if not vgg_weights_path().is_file():
        return "not fetched yet; fits of textures and svbrdf_stationary need it: metapp data vgg"
    try:
        with open_tensors(vgg_weights_path()) as file:
            return f"from {(file.metadata() or {}).get('source', 'unknown')}"
    except (OSError, SafetensorError):
        raise ValueError("damaged: fits to pictures fail; fetch it again: metapp data vgg") from None
