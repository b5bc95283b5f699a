"""Single files: only regular files are read, and a file that is written is there whole or not at all.

A new file gets a temporary name in its folder and is then renamed: a link of its name is replaced, never followed.
What files mean is not known here.
"""

from __future__ import annotations

import codecs
import contextlib
import errno
import filecmp
import functools
import hashlib
import io
import json
import math
import os
import re
import secrets
import shutil
import stat
import tempfile
import time
import unicodedata
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from safetensors import safe_open

if TYPE_CHECKING:
    from torch import Tensor

PARTIAL_PREFIX = ".partial-"  # the beginning of the name of an unfinished file
_STALE_SECONDS = 86400.0  # after which an unfinished file that nobody has written to was left by a killed program
MAX_NAME_BYTES = 100  # of a task's name; file systems take 255, of which suffixes and temporary names need some
DISK_FULL_ERRNOS = (errno.ENOSPC, errno.EDQUOT)
_UNENDING = "{}: a pipe or device, expected a file; copy what it gives to a file."
_UTF16_MARKS = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
_WINDOWS_DEVICE = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\.|$)", re.IGNORECASE)  # a name that Windows reserves
# Files that a checkout or a download leaves in place of the file itself, or that hold files which no reader takes from
# them: beginnings in small letters, and the message
_PLACEHOLDERS = (
    ((b"version https://git-lfs",), "a Git LFS pointer, expected the file itself; fetch it by git lfs pull."),
    (
        (b"<!doctype html", b"<html"),
        "an HTML page, expected the file itself; download it again, by the link of the file.",
    ),
    (
        (b"pk\x03\x04", b"\x1f\x8b\x08", b"7z\xbc\xaf\x27\x1c", b"rar!\x1a", b"\xfd7zxz\0", b"bzh91ay&sy"),
        "packed, as archives and spreadsheets (.xlsx) are, expected the file itself; unpack it, or export it as .csv.",
    ),
    ((b"%pdf-",), "a PDF document, expected the file itself; export its picture as PNG, or its table as .csv."),
)
_PLACEHOLDER_BYTES = 256  # of a file, in which its beginning is looked for after blanks


def open_regular(path: str | Path) -> io.BufferedReader:
    """Open a regular file to read.

    Raises:
        ValueError: the path is a pipe or a device, which may have no end.
        OSError: it cannot be read, or is a folder.
    """
    # non-blocking, since opening a pipe that nobody writes to would wait without end
    descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    mode = os.fstat(descriptor).st_mode
    if stat.S_ISREG(mode):
        return open(descriptor, "rb")
    os.close(descriptor)
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(f"{path}: a folder, expected a file; name a file in it.")
    raise ValueError(_UNENDING.format(path))


def read_bytes(path: str | Path) -> bytes:
    """Read the content of a regular file; see :func:`open_regular` for the errors."""
    with open_regular(path) as file:
        return file.read()


def open_text(path: str | Path) -> io.TextIOWrapper:
    """Open a text file of a user, in UTF-8, or in UTF-16 if it begins with its byte order mark.

    The mark is no part of the text. Line ends of Unix, Windows and Mac are read as line ends of Unix.

    Raises:
        ValueError: libraries must not read the path, see :func:`check_readable`.
        OSError: the file cannot be read, or is a folder.
    """
    check_readable(Path(path))
    stream = open_regular(path)
    return io.TextIOWrapper(stream, "utf-16" if stream.peek(2)[:2] in _UTF16_MARKS else "utf-8-sig")


def read_text(path: str | Path) -> str:
    """Read a whole text file; see :func:`open_text` for the encoding and the errors.

    Raises:
        UnicodeDecodeError: the file holds bytes that are not text in this encoding.
    """
    with open_text(path) as file:
        return file.read()


@contextlib.contextmanager
def open_tensors(path: str | Path, device: str = "cpu") -> Iterator[Any]:
    """Open a safetensors file by `safetensors.safe_open` for the time of a `with` block.

    Args:
        path: the file.
        device: the device that tensors are read to.

    Raises:
        OSError: the file cannot be opened.
        ValueError: libraries must not read the path, see :func:`check_readable`.
        SafetensorError: the file is damaged.
    """
    check_readable(Path(path))
    with open_regular(path), safe_open(path, "pt", device=device) as stored:
        yield stored


def read_tensors(path: str | Path) -> dict[str, Tensor]:
    """Read all tensors of a safetensors file to the CPU, by name; see :func:`open_tensors` for the errors."""
    with open_tensors(path) as stored:
        return {key: stored.get_tensor(key) for key in stored.keys()}  # noqa: SIM118  (not a mapping)


def check_readable(path: Path) -> None:
    """Refuse a path that libraries must not read.

    Raises:
        ValueError: the path is not UTF-8, which libraries do not open; it exists and is neither a file nor a folder,
            which libraries would read without end; or it is a placeholder, see :func:`placeholder_line`.
    """
    try:
        str(path).encode()
    except UnicodeEncodeError:
        raise ValueError(f"{str(path)!a}: a name that is not UTF-8, expected one that is; rename it.") from None
    if path.exists() and not path.is_file() and not path.is_dir():
        raise ValueError(_UNENDING.format(path))
    if line := placeholder_line(path):
        raise ValueError(line)


def placeholder_line(path: Path) -> str:
    """Return the error message about a file in place of the one that a user wants: left for it, or with it inside.

    Returns:
        The message if the file is a Git LFS pointer, a page in HTML, an archive or a PDF; "" for any other path.
    """
    try:
        with open_regular(path) as file:
            start = file.read(_PLACEHOLDER_BYTES).removeprefix(codecs.BOM_UTF8).lstrip().lower()
    except (OSError, ValueError):  # whoever reads the file will say that it cannot be read
        return ""
    return next((f"{path}: {line}" for beginnings, line in _PLACEHOLDERS if start.startswith(beginnings)), "")


def write_atomically(path: str | Path, write: Callable[[Path], object], previous: Path | None = None) -> None:
    """Write a file so that it is there whole or not at all, even if the program is killed or the power fails.

    Args:
        path: the file; an existing file is replaced at the end, missing folders are made.
        write: a function that writes all content to the path it is given, a name in the same folder with an equal
            suffix.
        previous: the path in the same folder where a replaced file is kept if its content differs; None to keep none.

    Raises:
        OSError: the file cannot be written, and an existing file stays; the message names the folder.

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
            _sync(partial, os.O_RDWR)  # opened to write, too, which Windows needs to sync a file
            # a file of equal content was written by this command before it was killed, so that `previous` already
            # holds the file to keep
            if previous and path.is_file() and not filecmp.cmp(partial, path, shallow=False):
                write_atomically(previous, functools.partial(shutil.copyfile, path))
            os.replace(partial, path)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise
    with contextlib.suppress(OSError):  # some systems do not open folders
        _sync(path.parent, os.O_RDONLY)


def write_bytes(path: str | Path, content: bytes, previous: Path | None = None) -> None:
    """Write a file of given content so that it is there whole or not at all; see :func:`write_atomically`."""
    write_atomically(path, lambda partial: partial.write_bytes(content), previous)


@contextlib.contextmanager
def name_file_in_errors(path: Path) -> Iterator[None]:
    """Let errors of writing a file name the file and its folder, which the system's errors often do not.

    Args:
        path: the file that is written in the `with` block, perhaps under a temporary name.

    Raises:
        OSError: instead of an error of the system that names no file or an unfinished one.
    """
    try:
        yield
    except OSError as error:
        folder = Path(str(error.filename or path)).parent
        if not error.errno or (folder != path.parent and not folder.name.startswith(PARTIAL_PREFIX)):
            raise
        remedy = "choose another folder"
        if error.errno in DISK_FULL_ERRNOS:
            remedy = "free some space or choose another folder"
        naming_error = OSError(f"{path.parent}: {os.strerror(error.errno)}; {path.name} was not written; {remedy}.")
        naming_error.errno = error.errno
        raise naming_error from error


def _sync(path: Path, mode: int) -> None:
    """Wait until the content of a file, or the list of names in a folder, is on the disk.

    Args:
        path: the file or the folder.
        mode: flags to open it with.
    """
    handle = os.open(path, mode)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def add_suffix(path: Path, suffix: str) -> Path:
    """Add a suffix such as ".glb" to a path unless the path has it already: other dots may be part of a name.

    >>> add_suffix(Path("stone-v1.2"), ".glb").name
    'stone-v1.2.glb'
    """
    return path if path.suffix == suffix else path.with_name(f"{path.name}{suffix}")


def content_digest(document: object) -> str:
    """Return 12 hexadecimal digits that change with a JSON-ready document, whatever the order of its entries.

    >>> content_digest({"seed": 0, "steps": 10}) == content_digest({"steps": 10, "seed": 0})
    True
    """
    return hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()[:12]


def file_digest(path: Path) -> str:
    """Return 12 hexadecimal digits that change with the bytes of a file."""
    return hashlib.sha256(read_bytes(path)).hexdigest()[:12]


def make_writable_folder(folder: Path) -> None:
    """Make a folder if it is missing, and test that files can be written to it.

    Raises:
        OSError: it cannot be made or written to.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryFile(dir=folder):  # a file without a name, since other programs may write here, too
        pass


def require_new_file(path: Path, *, overwrite: bool) -> None:
    """Refuse to replace a file, unless it may be replaced: one that is there already may be a measurement.

    Raises:
        FileExistsError: the file is there already, or a link of its name is.
    """
    if not overwrite and os.path.lexists(path):
        raise FileExistsError(f"{path}: is there already, expected a new file; overwrite=True replaces it.")


def move_files(source: Path, target: Path, *, overwrite: bool) -> None:
    """Move all files of a folder into another folder on the same disk; other files that are there stay.

    Args:
        source: the folder that holds the files, at any depth.
        target: the folder that they get into; it and folders in it are made where they are missing.
        overwrite: whether existing files are replaced.

    Raises:
        FileExistsError: a file is there already; nothing was moved.
        OSError: a file cannot be moved.
    """
    files = [file for file in source.rglob("*") if file.is_file()]
    places = [target / file.relative_to(source) for file in files]
    for place in places:
        require_new_file(place, overwrite=overwrite)
    for file, place in zip(files, places, strict=True):
        place.parent.mkdir(parents=True, exist_ok=True)
        os.replace(file, place)


def partial_path(path: Path) -> Path:
    """Return a temporary path for a file that is being written: in the same folder, with an equal suffix.

    Each call returns another path, so that two programs may write one file at the same time.
    """
    # the suffix stays, since image writers choose the format by it
    return path.with_name(f"{PARTIAL_PREFIX}{secrets.token_hex(4)}-{path.name}")


def remove_partial(folder: Path) -> None:
    """Remove the unfinished files and folders in a folder that killed programs left more than a day ago."""
    for unfinished in folder.glob(f"{PARTIAL_PREFIX}*"):
        if not re.fullmatch(rf"{re.escape(PARTIAL_PREFIX)}[0-9a-f]{{8}}-.+", unfinished.name, re.DOTALL):
            continue  # a user's file
        with contextlib.suppress(OSError):  # another program has finished it since, or another user owns it
            status = unfinished.lstat()
            if time.time() - status.st_mtime > _STALE_SECONDS:
                if stat.S_ISDIR(status.st_mode):
                    shutil.rmtree(unfinished, ignore_errors=True)
                else:
                    unfinished.unlink()


def error_about_file(error: Exception, source: Path) -> ValueError:
    """Return an error that a reader met as a ValueError whose message names the file.

    >>> error_about_file(ValueError("12 bytes, expected 16"), Path("brdfs/gold.binary"))
    ValueError('brdfs/gold.binary: 12 bytes, expected 16')
    """
    text = error_text(error)
    return ValueError(text if source.name in text else f"{source}: {text}")


def error_text(error: BaseException) -> str:
    """Return the message of an error; of one of the system the file and the reason, without the reason's number.

    >>> error_text(FileNotFoundError(2, "No such file or directory", "gold.binary"))
    'gold.binary: No such file or directory'
    """
    if isinstance(error, OSError) and error.strerror:
        return error.strerror if error.filename is None else f"{error.filename}: {error.strerror}"
    return str(error) or type(error).__name__


def to_json_value(value: Any) -> Any:
    """Convert a value to one that a JSON file can hold.

    Tuples become lists, and numbers that are not finite None. Bytes of a path that are no text, which Python passes on
    as lone surrogates, are escaped, since readers of JSON refuse these.

    >>> to_json_value({"error": float("nan"), "seconds": (0.5, 1.0)})
    {'error': None, 'seconds': [0.5, 1.0]}
    """
    if isinstance(value, str):
        return value.encode("utf-8", "backslashreplace").decode()
    if isinstance(value, dict):
        return {to_json_value(key): to_json_value(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [to_json_value(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def printable_name(name: str) -> str:
    """Return a name that can be printed and drawn, of MAX_NAME_BYTES bytes at most.

    Characters that are not printable, such as line ends, become underscores. A name that is changed or cut ends with a
    digest of the whole name.

    >>> printable_name("old gold"), printable_name("old" + chr(10) + "gold")
    ('old gold', 'old_gold-1c7b39')
    """
    printable = "".join(c if c.isprintable() or unicodedata.category(c) == "Zs" else "_" for c in name)
    return _add_digest_if_changed(printable, name)


def file_name(name: str) -> str:
    """Return a name as a file name: letters, digits, dot, underscore and hyphen, the rest as underscores.

    It has MAX_NAME_BYTES bytes at most and neither begins nor ends with a dot, and is not reserved by Windows. A name
    that is changed or cut ends with a digest of the whole name.

    >>> file_name("old-gold"), file_name("old gold"), file_name("aux")
    ('old-gold', 'old_gold-0d18a0', '_aux-321f68')
    """
    safe_name = re.sub(r"[^\w.-]", "_", name).strip(".") or "task"
    return _add_digest_if_changed(f"_{safe_name}" if _WINDOWS_DEVICE.match(safe_name) else safe_name, name)


def _add_digest_if_changed(safe_name: str, name: str) -> str:
    """Return a safe form of a name, cut and with a digest of the name unless it is the name itself and short enough."""
    if safe_name == name and len(safe_name.encode()) <= MAX_NAME_BYTES:
        return safe_name
    digest = hashlib.sha256(name.encode(errors="surrogatepass")).hexdigest()[:6]
    return f"{safe_name.encode()[: MAX_NAME_BYTES - 7].decode(errors='ignore')}-{digest}"
