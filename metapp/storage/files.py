"""Files: those that are read are regular ones, those that are written are there whole or not at all.

A new file gets a temporary name in the same folder and is renamed: a link that lies there is replaced, never
followed. Only regular files are opened. Names of files may have bytes that are no UTF-8, which Python passes on as
lone surrogates.
"""

from __future__ import annotations

import codecs
import contextlib
import errno
import filecmp
import functools
import glob
import hashlib
import io
import json
import math
import os
import re
import shutil
import stat
import unicodedata
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from safetensors import safe_open

from metapp.storage.placeholders import START_BYTES, placeholder_of

if TYPE_CHECKING:
    from torch import Tensor

PARTIAL_PREFIX = ".partial-"  # what the name of an unfinished file begins with
MAX_NAME_BYTES = 100  # of a name at most; file systems take 255, of which suffixes and temporary names need some
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


_BYTE_ORDER_MARKS = (  # those of UTF-32 first: one of them begins as that of UTF-16 does
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)


def open_text(path: str | Path) -> io.TextIOWrapper:
    """Open a text file of a user, in UTF-8 or in what its byte order mark says, with line ends of Unix, Windows or Mac.

    The mark is no part of the text, and all line ends are read as those of Unix.

    Raises:
        ValueError, OSError: as `open_regular`; a placeholder, as `check_readable`.
    """
    check_readable(Path(path))
    stream = open_regular(path)
    start = stream.peek(4)
    encoding = next((name for mark, name in _BYTE_ORDER_MARKS if start.startswith(mark)), "utf-8-sig")
    return io.TextIOWrapper(stream, encoding)


def read_text(path: str | Path) -> str:
    """Read a whole text file; errors as of `open_text`, and UnicodeDecodeError."""
    with open_text(path) as file:
        return file.read()


@contextlib.contextmanager
def open_tensors(path: str | Path, device: str = "cpu") -> Iterator[Any]:
    """A file as `safetensors.safe_open` gives it.

    Raises:
        OSError: it cannot be opened.
        ValueError: it is no file, or stands for another one.
        SafetensorError: it is damaged.
    """
    check_readable(Path(path))
    with open_regular(path) as file:
        place = path if str(path).isprintable() else f"/dev/fd/{file.fileno()}"  # it takes no bytes that are not UTF-8
        with safe_open(place, "pt", device=device) as stored:
            yield stored


def read_tensors(path: str | Path) -> dict[str, Tensor]:
    """All tensors of a file, on the CPU.

    Raises:
        OSError, SafetensorError: as `open_tensors`.
    """
    with open_tensors(path) as stored:
        return {key: stored.get_tensor(key) for key in stored.keys()}  # noqa: SIM118  (not a mapping)


def check_readable(path: Path) -> None:
    """Refuse a pipe or a device, which libraries would read without an end, and a file that stands for another one.

    Raises:
        ValueError: neither a file nor a folder, though it is there; a placeholder, such as a Git LFS pointer.
    """
    if path.exists() and not path.is_file() and not path.is_dir():
        raise ValueError(_UNENDING.format(path))
    if line := placeholder_line(path):
        raise ValueError(line)


def placeholder_line(path: Path) -> str:
    """Return the line about a file that stands for another one (`placeholder_of`); "" for all others and folders."""
    try:
        with open_regular(path) as file:
            found = placeholder_of(file.read(START_BYTES))
    except (OSError, ValueError):  # its reader says so
        return ""
    return f"{path}: {found}" if found else ""


def write_atomically(path: str | Path, write: Callable[[Path], object], previous: Path | None = None) -> None:
    """Write a file so that it is there whole or not at all, even if the program is killed or the power fails.

    Args:
        path: the file; an existing one is replaced at the end, missing folders are made.
        write: writes everything to the path it is given: a name in the same folder, with the same suffix.
        previous: another name in that folder for the file that is replaced, if there is one of other content.

    Raises:
        OSError: it cannot be written; names the folder. The file of before is still there.

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_atomically(f"{folder}/note.txt", lambda partial: partial.write_text("whole"))
    ...     read_text(f"{folder}/note.txt")
    'whole'
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = partial_path(path)
    try:
        with name_file_in_errors(path):
            partial.unlink(missing_ok=True)
            write(partial)
            _sync(partial, os.O_RDWR)  # as Windows needs it
            # one of the same bytes is what this program wrote before it was killed: the one before that stays
            if previous and path.is_file() and not filecmp.cmp(partial, path, shallow=False):
                write_atomically(previous, functools.partial(shutil.copyfile, path))
            os.replace(partial, path)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise
    with contextlib.suppress(OSError):  # not every system opens folders
        _sync(path.parent, os.O_RDONLY)


def write_bytes(path: str | Path, content: bytes, previous: Path | None = None) -> None:
    """Write a file of this content, as `write_atomically`."""
    write_atomically(path, lambda partial: partial.write_bytes(content), previous)


@contextlib.contextmanager
def name_file_in_errors(path: Path) -> Iterator[None]:
    """Errors of writing a file name it and its folder, which those of the system often do not.

    Raises:
        OSError: instead of one without a file name or of an unfinished file.
    """
    try:
        yield
    except OSError as error:
        place = Path(str(error.filename or path)).parent
        if not error.errno or (place != path.parent and not place.name.startswith(PARTIAL_PREFIX)):
            raise
        room = (
            "free some space or choose another folder" if error.errno in DISK_FULL_ERRNOS else "choose another folder"
        )
        error_about_file = OSError(f"{path.parent}: {os.strerror(error.errno)}; {path.name} was not written; {room}.")
        error_about_file.errno = error.errno
        raise error_about_file from error


DISK_FULL_ERRNOS = (errno.ENOSPC, errno.EDQUOT)


def _sync(path: Path, mode: int) -> None:
    """Wait until a file, or the names in a folder, are on the disk."""
    handle = os.open(path, mode)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def add_suffix(path: Path, suffix: str) -> Path:
    """A path with this suffix, such as ".glb", added unless it is there: other dots may be part of a name.

    >>> suffixed(Path("stone-v1.2"), ".glb").name
    'stone-v1.2.glb'
    """
    return path if path.suffix == suffix else path.with_name(f"{path.name}{suffix}")


def partial_path(path: Path) -> Path:
    """The temporary name of a file that is being written: in the same folder, with the same suffix."""
    # The suffix stays, since image writers choose the format by it; the rest keeps two programs apart.
    return path.with_name(f"{PARTIAL_PREFIX}{os.getpid()}-{_PROGRAM}-{path.name}")


def remove_partial(path: Path) -> None:
    """Remove unfinished files and folders of this name by programs that were killed; those of running ones stay."""
    for left in path.parent.glob(f"{PARTIAL_PREFIX}*-{glob.escape(path.name)}"):
        number = left.name.removeprefix(PARTIAL_PREFIX).split("-")[0]
        if number.isdigit() and int(number) != os.getpid() and not _runs(int(number)):
            shutil.rmtree(left) if left.is_dir() else left.unlink(missing_ok=True)


def _runs(process: int) -> bool:
    if os.name == "nt":  # where asking would end it
        return True
    try:
        os.kill(process, 0)
    except OSError as error:
        return not isinstance(error, ProcessLookupError)  # else it is another user's
    return True


def error_about_file(error: Exception, source: Path) -> ValueError:
    """An error that a reader met, with the file named.

    >>> error_about_file(ValueError("12 bytes, expected 16"), Path("brdfs/gold.binary"))
    ValueError('brdfs/gold.binary: 12 bytes, expected 16')
    """
    text = str(error) or type(error).__name__
    return ValueError(text if source.name in text else f"{source}: {text}")


def get_json_entry(document: object, key: str, kind: type, where: str, remedy: str, absent: object = None) -> Any:
    """An entry of a JSON object; `absent` if there is none.

    Raises:
        ValueError: it is of another type; the message begins with `place` and ends with the remedy.

    >>> entry_of({"steps": "3"}, "steps", int, "record.json: ", "fit again")
    Traceback (most recent call last):
    ValueError: record.json: 'steps' is "3", expected a whole number; fit again.
    """
    value = document.get(key, absent) if isinstance(document, dict) else None
    if not isinstance(value, kind) or isinstance(value, bool):
        raise ValueError(f"{where}'{key}' is {json.dumps(value)[:60]}, expected {_KINDS[kind]}; {remedy}.")
    return value


_KINDS = {int: "a whole number", str: "text", list: "a list", dict: "an object"}


def to_json_value(value: Any) -> Any:
    r"""A text, or a document, as JSON holds it: lone surrogates escaped, as \udcff, None for numbers not finite.

    >>> as_text({"error": float("nan"), "seconds": (0.5, 1.0)})
    {'error': None, 'seconds': [0.5, 1.0]}
    """
    if isinstance(value, str):
        return value.encode("utf-8", "backslashreplace").decode()
    if isinstance(value, dict):
        return {to_json_value(key): to_json_value(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [to_json_value(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def path_from_json_text(text: str) -> Path:
    """The path that `to_json_value` made a text of, if it is there; else that of the text itself."""
    path = Path(re.sub(r"\\udc([89a-f][0-9a-f])", lambda escaped: chr(0xDC00 + int(escaped[1], 16)), text))
    return path if os.path.lexists(path) else Path(text)


def printable_name(name: str) -> str:
    """A name that can be printed and drawn, of NAME_BYTES bytes at most; others get a digest of the whole.

    Control characters, line ends and bytes that are no text (lone surrogates) become underscores.

    >>> safe_name("old gold"), safe_name("old" + chr(10) + "gold")
    ('old gold', 'old_gold-1c7b39')
    """
    return _marked("".join("_" if unicodedata.category(c)[0] == "C" or c in "\u2028\u2029" else c for c in name), name)


def file_name(task: str) -> str:
    """A task's name as a file name: letters, digits, dot, underscore and hyphen, the rest as underscores.

    It has NAME_BYTES bytes at most; one that differs from the task's name ends with a digest of that.

    >>> file_name("old-gold"), file_name("old gold")
    ('old-gold', 'old_gold-0d18a0')
    """
    return _marked("".join(c if c.isalnum() or c in "._-" else "_" for c in task).lstrip(".") or "task", task)


def _marked(safe: str, name: str) -> str:
    """`safe` if it is the name itself and short, else with a digest of the name."""
    if safe == name and len(safe.encode()) <= MAX_NAME_BYTES:
        return safe
    mark = hashlib.sha256(name.encode(errors="surrogatepass")).hexdigest()[:6]
    return f"{safe.encode()[: MAX_NAME_BYTES - 7].decode(errors='ignore')}-{mark}"
