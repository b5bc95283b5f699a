"""Files that are files: what is read is no pipe or device, what is written goes through no link of somebody else's."""

from __future__ import annotations

import io
import os
import stat
from pathlib import Path

_ROOTS: set[Path] = set()


def write_plainly(folder: Path) -> None:
    """Follow no links below a folder from now on, in writing: it may have been sent by somebody else."""
    _ROOTS.add(folder.absolute())


def check_plain(path: Path) -> None:
    """Refuse to write a file of such a folder through a link between the two.

    Raises:
        ValueError: there is one.
    """
    parents = path.absolute().parents
    if not _ROOTS.isdisjoint(parents):
        outermost = max(i for i, folder in enumerate(parents) if folder in _ROOTS)
        for folder in parents[:outermost]:
            if folder.is_symlink():
                raise _linked(folder, "folder")


def open_own(path: Path, flags: int) -> int:
    """Open a file to write to, which is made if missing; the descriptor.

    Raises:
        ValueError: it is a link, symbolic or hard, or no file.
    """
    check_plain(path)
    if path.is_symlink():
        raise _linked(path, "file")
    descriptor = _regular(path, os.open(path, flags | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK, 0o666))
    if os.fstat(descriptor).st_nlink > 1:
        os.close(descriptor)
        raise _linked(path, "file")
    return descriptor


def open_regular(path: str | Path) -> io.BufferedReader:
    """Open a file to read.

    Raises:
        ValueError: it is no file, such as a pipe that has no end.
        OSError: it cannot be read.
    """
    return open(_regular(path, os.open(path, os.O_RDONLY | os.O_NONBLOCK)), "rb")


def read_bytes(path: str | Path) -> bytes:
    """The content of a file; errors as of `open_regular`."""
    with open_regular(path) as file:
        return file.read()


def read_text(path: str | Path, encoding: str = "utf-8") -> str:
    """The text of a file, its line ends as those of Unix; errors as of `open_regular`, and UnicodeDecodeError."""
    return read_bytes(path).decode(encoding).replace("\r\n", "\n").replace("\r", "\n")


def check_readable(path: Path) -> None:
    """Refuse what libraries would read without an end, such as a pipe or a device.

    Raises:
        ValueError: neither a file nor a folder, though it is there.
    """
    if path.exists() and not path.is_file() and not path.is_dir():
        raise _unending(path)


def _regular(path: str | Path, descriptor: int) -> int:
    mode = os.fstat(descriptor).st_mode
    if stat.S_ISREG(mode):
        return descriptor
    os.close(descriptor)
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(f"{path}: a folder, expected a file; name a file in it.")
    raise _unending(path)


def _unending(path: str | Path) -> ValueError:
    return ValueError(f"{path}: a pipe or device, expected a file; copy what it gives to a file.")


def _linked(path: Path, kind: str) -> ValueError:
    return ValueError(f"{path}: a link, expected a {kind} of this folder; remove it or write to another folder.")
