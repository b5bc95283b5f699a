"""Files: those that are read are regular ones, those that are written are there whole or not at all.

What is written gets a temporary name in the same folder and is renamed: a link that lies there is replaced, never
followed. What is opened is a regular file.
"""

from __future__ import annotations

import contextlib
import errno
import filecmp
import glob
import io
import os
import shutil
import stat
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

try:
    import fcntl
except ImportError:  # Windows: `locked` keeps nobody out
    fcntl = None  # type: ignore[assignment]

if TYPE_CHECKING:
    import xml.etree.ElementTree as ET

PARTIAL = ".partial-"  # what the name of an unfinished file begins with
_PROGRAM = os.urandom(3).hex()  # programs on two machines of a cluster may have the same process id


def open_regular(path: str | Path) -> io.BufferedReader:
    """Open a file to read.

    Raises:
        ValueError: it is no file, such as a pipe that has no end.
        OSError: it cannot be read.
    """
    # a pipe that nobody writes to would be waited for
    descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    mode = os.fstat(descriptor).st_mode
    if stat.S_ISREG(mode):
        return open(descriptor, "rb")
    os.close(descriptor)
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(f"{path}: a folder, expected a file; name a file in it.")
    raise ValueError(_UNENDING.format(path))


_UNENDING = "{}: a pipe or device, expected a file; copy what it gives to a file."


def read_bytes(path: str | Path) -> bytes:
    """The content of a file; errors as of `open_regular`."""
    with open_regular(path) as file:
        return file.read()


def read_text(path: str | Path, encoding: str = "utf-8") -> str:
    """The text of a file, its line ends as those of Unix; errors as of `open_regular`, and UnicodeDecodeError."""
    return read_bytes(path).decode(encoding).replace("\r\n", "\n").replace("\r", "\n")


def check_readable(path: Path) -> None:
    """Refuse what libraries would open themselves and read without an end, such as a pipe or a device.

    Raises:
        ValueError: neither a file nor a folder, though it is there.
    """
    if path.exists() and not path.is_file() and not path.is_dir():
        raise ValueError(_UNENDING.format(path))


def write_atomically(path: str | Path, write: Callable[[Path], object], previous: Path | None = None) -> None:
    """Write a file so that it is there whole or not at all, even if the program is killed or the power fails.

    Args:
        path: the file; an existing one is replaced at the end, missing folders are made.
        write: writes everything to the path it is given: a name in the same folder, with the same suffix.
        previous: another name in that folder for the file that is replaced, if there is one of other content.

    Raises:
        OSError: it cannot be written; names the folder. What was there before is still there.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = partial_path(path)
    try:
        with naming(path):
            partial.unlink(missing_ok=True)
            write(partial)
            _sync(partial)
            # one of the same bytes is what this program wrote before it was killed: the one before that stays
            if previous and path.is_file() and not filecmp.cmp(partial, path, shallow=False):
                _keep_as(previous, path)
            os.replace(partial, path)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise
    with contextlib.suppress(OSError):  # not every system opens folders
        _sync(path.parent)


def write_xml(path: Path, root: ET.Element) -> None:
    """Write an XML document, indented, whole or not at all."""
    from xml.etree.ElementTree import indent, tostring  # here: every command imports this module

    indent(root)
    content: bytes = tostring(root, encoding="utf-8", xml_declaration=True)
    write_atomically(path, lambda target: target.write_bytes(content + b"\n"))


@contextlib.contextmanager
def naming(path: Path) -> Iterator[None]:
    """Errors of writing a file name it and its folder, which those of the system often do not.

    Raises:
        OSError: instead of one without a file name or of an unfinished file.
    """
    try:
        yield
    except OSError as error:
        if not error.errno or (error.filename and Path(str(error.filename)).parent != path.parent):
            raise
        room = "free some space or choose another folder" if error.errno in _FULL else "choose another folder"
        named = OSError(f"{path.parent}: {os.strerror(error.errno)}; {path.name} was not written; {room}.")
        named.errno = error.errno
        raise named from error


_FULL = (errno.ENOSPC, errno.EDQUOT)


def _sync(path: Path) -> None:
    """Wait until a file, or the names in a folder, are on the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _keep_as(name: Path, path: Path) -> None:
    """Give a file a second name, whose own file is replaced at once; a copy where there are no links."""
    partial = partial_path(name)
    partial.unlink(missing_ok=True)
    try:
        os.link(path, partial)
    except OSError:
        shutil.copyfile(path, partial)
    os.replace(partial, name)
    partial.unlink(missing_ok=True)  # still there where both were the same file already


def suffixed(path: Path, suffix: str) -> Path:
    """A path with this suffix, such as ".glb", added unless it is there: other dots may be part of a name."""
    return path if path.suffix == suffix else path.with_name(f"{path.name}{suffix}")


def partial_path(path: Path) -> Path:
    """Where to write a file until it is whole: in the same folder, with the same suffix."""
    # The suffix stays, since image writers choose the format by it; the rest keeps two programs apart.
    return path.with_name(f"{PARTIAL}{os.getpid()}-{_PROGRAM}-{path.name}")


def remove_partial(path: Path) -> None:
    """Remove what programs left of a file when they were killed; of those that still run, nothing."""
    for left in path.parent.glob(f"{PARTIAL}*-{glob.escape(path.name)}"):
        number = left.name.removeprefix(PARTIAL).split("-")[0]
        if number.isdigit() and int(number) != os.getpid() and not _runs(int(number)):
            left.unlink(missing_ok=True)


def _runs(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:  # another user's
        return True
    return True


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
    if fcntl is None:
        yield
        return
    descriptor = os.open(path, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        if not (path.exists() and os.path.samestat(os.fstat(descriptor), path.stat())):
            raise BlockingIOError(f"{path}: removed by another program meanwhile; run the command again.")
        yield
    finally:
        os.close(descriptor)


def named(error: Exception, source: Path) -> ValueError:
    """An error that a reader met, with the file named."""
    text = str(error) or type(error).__name__
    return ValueError(text if source.name in text else f"{source}: {text}")
