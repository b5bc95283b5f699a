"""Small C sources, compiled once for a source and a CPU, kept in the cache folder, loaded through ctypes.

All of them are optional: without a compiler, torch computes instead. A library is code, so it is loaded only from a
folder that the user alone can write to, and a library gets its name there only when it is complete. This module does
not know what the sources compute.
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
import os
import platform
import shutil
import subprocess
from pathlib import Path

from metapp.storage.cache_folders import CACHE_VARIABLE, NATIVE_FOLDER, cache_folder, code_folder
from metapp.storage.files import read_text, write_atomically

# no -ffast-math: what it saves here is lost in noise, and it changes results and hides NaN
COMPILER_FLAGS = (
    *("-std=gnu11", "-O3", "-ffp-contract=fast", "-fno-math-errno", "-fno-trapping-math"),
    *("-fopenmp-simd", "-shared", "-fPIC"),
)
COMPILER_SECONDS = 60  # after which a compiler is stopped, and torch computes instead


@functools.cache
def load_library(source: Path, *names: str, march: str = "native") -> ctypes.CDLL | None:
    """Load a C source as a library, compiled if the cache folder does not hold it.

    Args:
        source: a C file; the headers in its folder count as part of it.
        names: the functions that the library must have.
        march: the instruction set, a name that the compiler knows; tests and benchmarks ask for others than this CPU's.

    Returns:
        The library; None if it can neither be found nor compiled, or lacks a function.
    """
    try:
        folder = code_folder(cache_folder() / NATIVE_FOLDER, CACHE_VARIABLE)
        path = folder / f"{source.stem}-{_source_digest(source, march)}.so"
        if not path.is_file():
            _compile(source, path, march)
        library = ctypes.CDLL(str(path))
    except OSError:  # no compiler, a broken one, a folder that cannot be written, a file of another machine
        return None
    return library if all(hasattr(library, name) for name in names) else None


def find_compiler() -> str | None:
    """Find the C compiler: the one that CC names if it is set, else the first of the usual names that is installed."""
    names = [os.environ["CC"]] if os.environ.get("CC") else ["cc", "gcc", "clang"]
    return next((path for path in map(shutil.which, names) if path), None)


def _source_digest(source: Path, march: str) -> str:
    """Return a digest of all that a compiled source and the width of its vectors depend on: text, options, CPU."""
    texts = (read_text(path) for path in (source, *sorted(source.parent.glob("*.h"))))
    return hashlib.sha256("\0".join((*texts, *COMPILER_FLAGS, march, _describe_cpu())).encode()).hexdigest()[:24]


def _describe_cpu() -> str:
    """Return the system's description of the CPU and its instruction sets, without figures that change."""
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8").split("\n\n", 1)[0].splitlines()
    except OSError:
        lines = [platform.processor()]
    changing = ("cpu MHz", "bogomips", "processor", "core id", "apicid")
    return "\n".join([platform.machine(), *(line for line in lines if not line.startswith(changing))])


def _compile(source: Path, path: Path, march: str) -> None:
    """Compile a source; if several processes do so at once, the file of the last one stays.

    Raises:
        OSError: there is no compiler, or it fails.
    """
    command = find_compiler()
    if command is None:
        raise FileNotFoundError("no C compiler")

    def write(partial: Path) -> None:
        arguments = [command, *COMPILER_FLAGS, f"-march={march}", str(source), "-o", str(partial), "-lm"]
        try:
            subprocess.run(arguments, check=True, capture_output=True, timeout=COMPILER_SECONDS)
        except subprocess.SubprocessError as error:
            raise OSError(f"{command}: does not compile {source.name}") from error

    write_atomically(path, write)
