"""Files that are there whole or not at all."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
from collections.abc import Callable, Iterator
from pathlib import Path

PARTIAL = ".partial-"  # what the name of an unfinished file begins with


def cache_folder() -> Path:
    """Where files are kept that can be had again: METAPP_CACHE if set, else the user's cache folder of this system."""
    import platformdirs

    return Path(os.environ.get("METAPP_CACHE") or platformdirs.user_cache_dir("metapp", appauthor=False))


def write_atomically(path: str | Path, write: Callable[[Path], object]) -> None:
    """Write a file so that it is there whole or not at all, even if the program is interrupted.

    Args:
        path: the file; an existing one is replaced at the end, missing folders are made.
        write: writes everything to the path it is given: a name in the same folder, with the same suffix.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = partial_path(path)
    try:
        write(partial)
        os.replace(partial, path)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise


def partial_path(path: Path) -> Path:
    """Where to write a file until it is whole: in the same folder, with the same suffix."""
    # The suffix stays, since image writers choose the format by it; the process id keeps two programs apart.
    return path.with_name(f"{PARTIAL}{os.getpid()}-{path.name}")


@contextlib.contextmanager
def locked(path: Path, *, wait: bool = True) -> Iterator[None]:
    """Hold an advisory lock on a file or folder that is there; it ends with the process, however that ends.

    Nothing is written beside it: the lock is the kernel's.

    Args:
        path: what to lock; only programs that ask for its lock, too, are kept out.
        wait: until another program has released it.

    Raises:
        BlockingIOError: another program holds it and `wait` is False, or has removed it meanwhile.
    """
    descriptor = os.open(path, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        if not (path.exists() and os.path.samestat(os.fstat(descriptor), path.stat())):
            raise BlockingIOError(f"{path}: removed by another program meanwhile; run the command again.")
        yield
    finally:
        os.close(descriptor)


def append_line(path: Path, line: bytes, is_whole: Callable[[bytes], bool]) -> None:
    """Append a line to a file by a single write, and have it on the disk; whoever appends must hold the file's lock.

    Args:
        path: the file, made if missing.
        line: without its end.
        is_whole: whether a last line without end is one all the same; else it is a torn one, which a program that was
            killed left behind: the new line takes its place.

    Raises:
        OSError: the disk is full; the file is then as before.
    """
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o666)
    try:
        size = os.fstat(descriptor).st_size
        tail = _last_line(descriptor, size)
        start = b"\n" if tail and is_whole(tail) else b""
        if tail and not start:
            size -= len(tail)
            os.ftruncate(descriptor, size)
        payload = start + line + b"\n"
        try:
            if os.write(descriptor, payload) < len(payload):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            os.fsync(descriptor)
        except OSError as error:
            os.ftruncate(descriptor, size)
            raise OSError(error.errno, error.strerror, str(path)) from None
    finally:
        os.close(descriptor)


def _last_line(descriptor: int, size: int) -> bytes:
    """What follows the last line's end, read from the file's end; nothing where the last line is whole."""
    tail, at = b"", size
    while at > 0 and b"\n" not in tail:
        step = min(at, 65536)
        at -= step
        tail = os.pread(descriptor, step, at) + tail
    return tail.rpartition(b"\n")[2]
