"""Mitsuba in a variant that renders many rays at once, with a libLLVM that does not abort the process.

Mitsuba takes a libLLVM when it is imported, and keeps it. So the first import in a process is by this module or by
:mod:`metapp.rendering.jit`, or follows :func:`choose_llvm`. Scenes are not known here.
"""

from __future__ import annotations

import ctypes
import os
import re
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from metapp.rendering.types import Mitsuba
from metapp.storage.cache_folders import KERNELS_FOLDER, cache_folder, code_folder

# major version: 15 and 16 abort the process at the first render, which no `except` can catch; Mitsuba refuses 14
OLDEST_LLVM = 19
LLVM_VARIABLE = "DRJIT_LIBLLVM_PATH"  # environment variable: where Dr.Jit, on which Mitsuba builds, finds the library
KERNELS_VARIABLE = "DRJIT_CACHE_DIR"  # environment variable: the folder of compiled kernels
LEAST_THREADS = 2  # Mitsuba has other threads write parts of EXR files, and waits for ever where there are none
LLVM_REMEDY = f"apt-get install libllvm19 libatomic1, or point {LLVM_VARIABLE} at such a library"
# folders of libraries in Debian and Ubuntu, Fedora, other systems, and macOS
_SYSTEM_FOLDERS = ("/usr/lib/*-linux-gnu", "/usr/lib/llvm-*/lib", "/usr/lib64", "/usr/lib64/llvm*/lib*", "/usr/lib",
           "/usr/local/lib", "/opt/homebrew/opt/llvm*/lib")  # fmt: skip


def load_mitsuba() -> Mitsuba:
    """Import Mitsuba: in the variant cuda_ad_rgb if torch has a GPU, else in llvm_ad_rgb with as many threads as torch.

    There are two threads at least, also if torch has one.

    Returns:
        The module `mitsuba`. The variant is the whole program's: code that needs another one sets it again.

    Raises:
        ValueError: Mitsuba cannot be imported, no libLLVM here is fit for it, or it was imported with an old one.
    """
    import torch

    on_gpu = torch.cuda.is_available()
    if not on_gpu:
        choose_llvm()
    choose_kernel_folder()
    try:
        import drjit
        import mitsuba
    except (ImportError, NameError) as error:  # drjit raises NameError after it failed to load libatomic
        reason = str(error.__context__ or error).partition("\n")[0]
        raise ValueError(f"mitsuba: {reason}, expected a package that can be imported; {LLVM_REMEDY}.") from None
    if not on_gpu and drjit.detail.llvm_version()[0] < OLDEST_LLVM:
        raise ValueError(
            f"mitsuba: imported before with libLLVM {drjit.detail.llvm_version()[0]}, expected {OLDEST_LLVM} or newer; "
            f"start again with {LLVM_VARIABLE}={os.environ[LLVM_VARIABLE]}."
        )
    mitsuba.set_variant("cuda_ad_rgb" if on_gpu else "llvm_ad_rgb")
    restrict_plugins(mitsuba)
    drjit.set_thread_count(max(LEAST_THREADS, torch.get_num_threads()))
    return mitsuba


def restrict_plugins(mitsuba: Mitsuba) -> None:
    """Have Mitsuba load plugins, which are native code, from its own folder alone.

    Otherwise it would look in the working folder first.
    """
    resolver = mitsuba.FileResolver()
    resolver.clear()
    resolver.append(str(Path(mitsuba.__file__).parent))
    mitsuba.set_file_resolver(resolver)


def choose_llvm() -> Path:
    """Have Mitsuba take a fit libLLVM when it is imported, in whatever variant: it takes one then, and keeps it.

    Returns:
        The library.

    Raises:
        ValueError: no libLLVM is new enough.
    """
    library = find_llvm()
    _preload_dependencies(library)
    os.environ[LLVM_VARIABLE] = str(library)
    return library


def choose_kernel_folder() -> None:
    """Have Dr.Jit, when it is imported, keep compiled kernels in a folder that nobody else can write to."""
    try:
        folder = code_folder(Path(os.environ.get(KERNELS_VARIABLE) or Path.home() / ".drjit"), KERNELS_VARIABLE)
    except (OSError, RuntimeError):  # the folder cannot be made, or there is no home folder
        folder = code_folder(cache_folder() / KERNELS_FOLDER, KERNELS_VARIABLE)
    os.environ[KERNELS_VARIABLE] = str(folder)


def find_llvm() -> Path:
    """Find the libLLVM for Mitsuba: the one that DRJIT_LIBLLVM_PATH names, this environment's or the system's.

    Only libraries without a version in their name are loaded.

    Raises:
        ValueError: no libLLVM is new enough.
    """
    unfit = []
    for path in _find_candidates():
        version = llvm_version(path)
        if version is not None and version >= OLDEST_LLVM:
            return path
        unfit.append(f"{path} (version {version or 'unknown'})")
    found = ", ".join(unfit) or "none"
    raise ValueError(f"libLLVM: found {found}, expected {OLDEST_LLVM} or newer for Mitsuba; {LLVM_REMEDY}.")


def llvm_version(path: Path) -> int | None:
    """Return the major version of a libLLVM, by its name or else by asking the library; None if it is no libLLVM."""
    if not path.exists():
        return None
    name_match = re.match(r"libLLVM[-.](?:so\.)?(\d+)", path.resolve().name)
    if name_match:
        return int(name_match[1])
    major, minor, patch = ctypes.c_uint(), ctypes.c_uint(), ctypes.c_uint()
    with suppress(OSError, AttributeError):  # it is no library, or older than version 16, which has this function first
        ctypes.CDLL(str(path)).LLVMGetVersion(ctypes.byref(major), ctypes.byref(minor), ctypes.byref(patch))
    return major.value or None


def _find_candidates() -> Iterator[Path]:
    """Yield files that may be libLLVM, each once: DRJIT_LIBLLVM_PATH's, this environment's, then the system's."""
    if os.environ.get(LLVM_VARIABLE):
        yield Path(os.environ[LLVM_VARIABLE])
    system_folders = (folder for pattern in _SYSTEM_FOLDERS for folder in sorted(Path("/").glob(pattern[1:])))
    yielded: set[Path] = set()
    for folder in (_setup_folder(), Path(sys.prefix) / "lib", *system_folders):
        for path in sorted(folder.glob("libLLVM[-.]*")):
            if path.resolve() not in yielded:
                yielded.add(path.resolve())
                yield path


def _setup_folder() -> Path:
    """Return the folder in which tools/setup.sh puts libLLVM, with its dependencies, if it may not install them."""
    return Path(sys.prefix) / "lib" / "llvm"


def _preload_dependencies(library: Path) -> None:
    """Load the libraries beside libLLVM in setup's folder: the loader looks for them in the system's folders only."""
    if library.parent != _setup_folder():
        return
    unloaded = [path for path in library.parent.glob("*.so*") if not path.name.startswith("libLLVM")]
    for _ in range(len(unloaded)):  # a library loads once its own dependencies are loaded; the order is found by trying
        for path in list(unloaded):
            with suppress(OSError):
                ctypes.CDLL(str(path))
                unloaded.remove(path)
