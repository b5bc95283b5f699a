"""Mitsuba in a variant that renders many rays at once, with a libLLVM that does not abort the process."""

from __future__ import annotations

import ctypes
import os
import re
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from metapp.rendering.types import Mitsuba
from metapp.storage.cache_folders import code_folder

OLDEST_LLVM = 19  # 15 and 16 abort the process at the first render, which no `except` can catch; 14 is refused
LLVM_VARIABLE = "DRJIT_LIBLLVM_PATH"  # where Dr.Jit, below Mitsuba, looks for the library
KERNELS_VARIABLE = "DRJIT_CACHE_DIR"
LEAST_THREADS = 2  # at least: Mitsuba hands parts of EXR files to other threads and waits for ever where there is none
LLVM_REMEDY = f"apt-get install libllvm19 libatomic1, or point {LLVM_VARIABLE} at such a library"
# Debian and Ubuntu, Fedora, others, macOS
_PLACES = ("/usr/lib/*-linux-gnu", "/usr/lib/llvm-*/lib", "/usr/lib64", "/usr/lib64/llvm*/lib*", "/usr/lib",
           "/usr/local/lib", "/opt/homebrew/opt/llvm*/lib")  # fmt: skip


def load_mitsuba() -> Mitsuba:
    """Import Mitsuba: in the variant cuda_ad_rgb if torch has a GPU, else in llvm_ad_rgb with as many threads.

    There are two threads at least, also if torch has one.

    Returns:
        The module `mitsuba`. The variant is the whole program's: code that needs another one sets it again.

    Raises:
        ValueError: Mitsuba cannot be imported, no libLLVM here is fit for it, or it has taken another one already.
    """
    import torch

    on_gpu = torch.cuda.is_available()
    if not on_gpu:
        choose_llvm()
    choose_kernel_folder()
    try:
        import drjit
        import mitsuba
    except (ImportError, NameError) as error:  # drjit trips over its own failure to load libatomic
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
    """Have Mitsuba load plugins, native code, from its own folder alone: it would look in the working folder first."""
    places = mitsuba.FileResolver()
    places.clear()
    places.append(str(Path(mitsuba.__file__).parent))
    mitsuba.set_file_resolver(places)


def choose_llvm() -> Path:
    """Have Mitsuba take a fit libLLVM when it is imported, in whatever variant: it takes one then, and keeps it.

    Raises:
        ValueError: none is there.
    """
    library = find_llvm()
    _preload(library)
    os.environ[LLVM_VARIABLE] = str(library)
    return library


def choose_kernel_folder() -> None:
    """Have Dr.Jit, when it is imported, keep compiled kernels in a folder that nobody else can write to."""
    with suppress(OSError, RuntimeError):  # no such folder can be made, or there is no home: then there are none
        folder = os.environ.get(KERNELS_VARIABLE) or Path.home() / ".drjit"
        os.environ[KERNELS_VARIABLE] = str(code_folder(Path(folder), KERNELS_VARIABLE))


def find_llvm() -> Path:
    """The libLLVM for Mitsuba: the one that DRJIT_LIBLLVM_PATH names, this environment's or the system's.

    Only libraries without a version in their name are loaded.

    Raises:
        ValueError: none is there that is new enough.
    """
    unfit = []
    for path in _candidates():
        version = llvm_version(path)
        if version is not None and version >= OLDEST_LLVM:
            return path
        unfit.append(f"{path} (version {version or 'unknown'})")
    found = ", ".join(unfit) or "none"
    raise ValueError(f"libLLVM: found {found}, expected {OLDEST_LLVM} or newer for Mitsuba; {LLVM_REMEDY}.")


def llvm_version(path: Path) -> int | None:
    """The major version of a libLLVM, by its name or else by asking it; None if there is none."""
    if not path.exists():
        return None
    named = re.match(r"libLLVM[-.](?:so\.)?(\d+)", path.resolve().name)
    if named:
        return int(named[1])
    major, minor, patch = ctypes.c_uint(), ctypes.c_uint(), ctypes.c_uint()
    with suppress(OSError, AttributeError):  # no library; older than 16, where the function came
        ctypes.CDLL(str(path)).LLVMGetVersion(ctypes.byref(major), ctypes.byref(minor), ctypes.byref(patch))
    return major.value or None


def _candidates() -> Iterator[Path]:
    if os.environ.get(LLVM_VARIABLE):
        yield Path(os.environ[LLVM_VARIABLE])
    system = (folder for place in _PLACES for folder in sorted(Path("/").glob(place[1:])))
    yielded: set[Path] = set()
    for folder in (_own_folder(), Path(sys.prefix) / "lib", *system):
        for path in sorted(folder.glob("libLLVM[-.]*")):
            if path.resolve() not in yielded:
                yielded.add(path.resolve())
                yield path


def _own_folder() -> Path:
    """The folder in which tools/setup.sh puts the library, and those it needs, if it may not install them."""
    return Path(sys.prefix) / "lib" / "llvm"


def _preload(library: Path) -> None:
    """Load the libraries that setup put beside it: the loader would look for these in the system's folders only."""
    if library.parent != _own_folder():
        return
    waiting = [path for path in library.parent.glob("*.so*") if not path.name.startswith("libLLVM")]
    for _ in range(len(waiting)):  # each after those that it needs itself, in an order found by trying
        for path in list(waiting):
            with suppress(OSError):
                ctypes.CDLL(str(path))
                waiting.remove(path)
