"""The process that reads mutated inputs: `python -m torture.worker TARGET SEED FIRST COUNT FOLDER`.

It prints `at N` before input N and one JSON object a finding; the parent learns from that where it died.
"""

from __future__ import annotations

import gc
import json
import os
import random
import resource
import shutil
import signal
import sys
import traceback
import warnings
from pathlib import Path
from typing import Any

from metapp.cli import console
from torture.report import fault_of_message
from torture.targets import TARGETS, BadResult, Target, mutated

CPU_SECONDS = 5.0  # of one input
_MEMORY = 3 * 2**30  # more than at the start
_MORE_HANDLES = 16


class _Hang(BaseException):
    pass


def _hang(*_: Any) -> None:
    raise _Hang


def fault(target: Target, rng: random.Random, folder: Path, valid: list[Any]) -> str:
    """Read one mutated input in an empty folder; what went wrong, or ""."""
    file = mutated(rng, target, folder, valid)
    signal.setitimer(signal.ITIMER_PROF, CPU_SECONDS)
    try:
        target.read(folder, file)
    except ValueError as error:
        if isinstance(error, UnicodeError):
            return f"{type(error).__name__}: {error}{_where(error)}"
        return fault_of_message(_as_shown(str(error)), folder.name, folder)
    except FloatingPointError:
        return ""
    except BadResult as error:
        return f"a bad result: {error}"
    except _Hang as error:
        return f"more than {CPU_SECONDS:.0f} s of CPU time{_where(error)}"
    except BaseException as error:
        return f"{type(error).__name__}: {str(error)[:150]}{_where(error)}"
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
    return ""


def _as_shown(message: str) -> str:
    """What the user sees of a message: the command line escapes and shortens."""
    return getattr(console, "one_line", str)(message)


def _where(error: BaseException) -> str:
    """The innermost line of the project's own."""
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if "torture" not in frame.filename]
    own = [frame for frame in frames if "site-packages" not in frame.filename and "/lib/python" not in frame.filename]
    return f" ({Path(own[-1].filename).name}:{own[-1].lineno} {own[-1].name})" if own else ""


def main(name: str, seed: str, first: int, count: int, place: str) -> None:
    """Read inputs `first` to `first + count - 1`."""
    warnings.simplefilter("ignore")
    target, valid = TARGETS[name], TARGETS[name].seeds()
    folder = Path(place) / "input"
    channel = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # what libraries print is not ours
    signal.signal(signal.SIGPROF, _hang)
    for files in valid:  # what is imported and cached now stays
        _fresh(folder, files)
        target.read(folder, folder / next(iter(files)))
    _limit_memory()
    handles = 0
    for index in range(first, first + count):
        _fresh(folder, {})
        print(f"at {index}", file=channel)
        what = fault(target, random.Random(f"{seed}/{name}/{index}"), folder, valid)
        if (index - first) % 200 == 100:
            gc.collect()
            now = len(os.listdir("/proc/self/fd"))
            handles = handles or now
            if now > handles + _MORE_HANDLES and not what:
                what, handles = f"{now - handles} file handles more than before", now
        if what:
            print(json.dumps({"index": index, "what": what}), file=channel)
    print("done", file=channel)


def _fresh(folder: Path, files: dict[str, bytes]) -> None:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    for name, content in files.items():
        (folder / name).write_bytes(content)


def _limit_memory() -> None:
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + _MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (most, most))


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4]), sys.argv[5])
