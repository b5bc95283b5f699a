"""Small C sources, compiled once for a source and a CPU, kept in the cache folder, loaded through ctypes.

All of them are optional: without a compiler, torch computes instead. A library is code, so it is loaded only from a
folder that the user alone can write to, in which a whole one alone gets its name.
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

from metapp.storage.cache_folders import cache_folder, code_folder
from metapp.storage.files import read_text, write_atomically

# no -ffast-math: what it saves here is lost in noise, and it changes results and hides NaN
COMPILER_FLAGS = (
    *("-std=gnu11", "-O3", "-ffp-contract=fast", "-fno-math-errno", "-fno-trapping-math"),
    *("-fopenmp-simd", "-shared", "-fPIC"),
)
COMPILER_SECONDS = 60  # until a compiler is given up


@functools.cache
def load_library(source: Path, *names: str, march: str = "native") -> ctypes.CDLL | None:
    """The functions of a C source; None if it can neither be found compiled nor be compiled, or lacks one.

    Args:
        source: a C file; the headers in its folder count as part of it.
        names: of the functions.
        march: the instructions to use, a name that the compiler knows. Other than this CPU's: tests and benchmarks.
    """
    try:
        folder = code_folder(cache_folder() / "native", "METAPP_CACHE")
        path = folder / f"{source.stem}-{_key(source, march)}.so"
        if not path.is_file():
            _compile(source, path, march)
        library = ctypes.CDLL(str(path))
    except OSError:  # no compiler, a broken one, a folder that cannot be written, a file of another machine
        return None
    return library if all(hasattr(library, name) for name in names) else None


def find_compiler() -> str | None:
    """The C compiler: CC if set, else the first of the usual names that there is."""
    names = [os.environ["CC"]] if os.environ.get("CC") else ["cc", "gcc", "clang"]
    return next((path for path in map(shutil.which, names) if path), None)


def _key(source: Path, march: str) -> str:
    """A digest of all that a compiled source, and the width of its vectors, depend on: text, options, CPU."""
    texts = (read_text(path) for path in (source, *sorted(source.parent.glob("*.h"))))
    return hashlib.sha256("\0".join((*texts, *COMPILER_FLAGS, march, _cpu())).encode()).hexdigest()[:24]


def _cpu() -> str:
    """The CPU and its instruction sets, as the system says it."""
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8").split("\n\n", 1)[0].splitlines()
    except OSError:
        lines = [platform.processor()]
    lasting = [line for line in lines if not line.startswith(("cpu MHz", "bogomips", "processor", "core id", "apicid"))]
    return "\n".join([platform.machine(), *lasting])


def _compile(source: Path, path: Path, march: str) -> None:
    """Compile a source; of processes that do so at the same time the last one's file stays.

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
