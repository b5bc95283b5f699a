"""Work in a forked process: what others may have prepared could end, block or change this one."""

from __future__ import annotations

import atexit
import faulthandler
import os
import shutil
import signal
import tempfile
from collections.abc import Callable
from pathlib import Path

SECONDS = 30  # of one


class BadResult(Exception):
    """Something returned or left what it must not."""


def in_child(said: Path, work: Callable[[], int]) -> int:
    """Do some work in a forked process.

    Args:
        said: file for an error's text.
        work: returns a code, 0 to 255.

    Raises:
        BadResult: an error, a signal, or SECONDS are over.
    """
    if (child := os.fork()) == 0:
        code = 255
        faulthandler.disable()  # a crash is the caller's to tell
        try:
            signal.alarm(SECONDS)
            code = work()
        except BaseException as error:
            said.write_text(f"{type(error).__name__}: {error}", errors="backslashreplace")
        os._exit(code)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if code < 0:
        raise BadResult(f"no end within {SECONDS} s" if code == -signal.SIGALRM else signal.Signals(-code).name)
    if code == 255:
        raise BadResult(said.read_text())
    return code


def remove(path: Path) -> None:
    """Remove a file, a link or a folder, if it is there."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def place_of_process() -> Path:
    """A new folder that is removed when this process ends."""
    place = Path(tempfile.mkdtemp(prefix="torture-process-"))
    atexit.register(shutil.rmtree, place, ignore_errors=True)
    return place
