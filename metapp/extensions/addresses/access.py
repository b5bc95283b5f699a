"""Inputs at addresses, read by copies that are removed afterwards; run folders that are kept at addresses.

A copy lies in a temporary folder, at a path that says its address, and is an ordinary file with all checks of one.
"""

from __future__ import annotations

import contextlib
import hashlib
import re
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

from metapp.extensions.addresses.store import PROTOCOLS, Place, opened, told
from metapp.runs import BadOption
from metapp.runs.reporter import say
from metapp.runs.requests.request import Request
from metapp.storage.files import PARTIAL, write_atomically
from metapp.storage.plain import read_bytes

TEMPORARY = "metapp-copy-"
RECORDS = "record.jsonl"
VERSIONS = ("ETag", "etag", "md5Hash", "generation", "LastModified", "last_modified", "mtime", "updated", "created")
_ADDRESS = re.compile(rf"(?:.*/{TEMPORARY}[^/]*/)?([a-z][a-z0-9+.-]+):/+(.+)", re.DOTALL)
_copies: dict[str, tuple[tempfile.TemporaryDirectory[str], Path]] = {}  # made to choose a recipe, until they are read


def address_of(path: Path) -> str:
    """The address that a path is, or that it is a copy of; "" for other paths."""
    match = _ADDRESS.fullmatch(str(path))
    if not match or (match[1] not in PROTOCOLS and path.exists()):
        return ""
    return f"{match[1]}://{match[2]}"


def objects(path: Path) -> dict[str, str]:
    """The objects at an address or of a pattern such as s3://bucket/*.binary, with a stamp that changes as they do.

    Returns:
        By address, sorted; none where there is a folder.

    Raises:
        ValueError: there is nothing, or it cannot be read.
    """
    place = opened(address_of(path))
    with told(place.address):
        if any(sign in place.address for sign in "*?[") and not place.scheme.startswith("http"):
            found = {name: info for name, info in place.files.glob(place.name, detail=True).items() if _is_file(info)}
            if not found:
                raise FileNotFoundError
            return {place.address_of(name): _stamp(info) for name, info in sorted(found.items())}
        info = place.files.info(place.name)
    return {place.address: _stamp(info)} if _is_file(info) else {}


def copies_of(path: Path) -> list[Path]:
    """Copies of what is at an address: of each object, or of a folder with all below it, at most once."""
    if TEMPORARY in str(path):  # one
        return [path]
    address = address_of(path)
    copies = []
    for each in objects(path) or [address]:
        if each not in _copies:
            _copies[each] = _copy(opened(each))
        copies.append(_copies[each][1])
    return copies


@contextlib.contextmanager
def copied(address: str) -> Iterator[Path]:
    """A copy of an object, for as long as this lasts; errors about the copy name the address."""
    folder, copy = _copies.pop(address) if address in _copies else _copy(opened(address))
    with folder:
        try:
            yield copy
        except (ValueError, OSError) as error:
            raise ValueError(str(error).replace(str(copy), address)) from None


def _copy(place: Place) -> tuple[tempfile.TemporaryDirectory[str], Path]:
    """Copy an object, or a folder with all below it, to a temporary folder."""
    temporary = tempfile.TemporaryDirectory(prefix=TEMPORARY)
    root = Path(temporary.name).resolve()
    with told(place.address):
        found = place.files.find(place.name, detail=True) or {place.name: place.files.info(place.name)}
        size, free = sum(info.get("size") or 0 for info in found.values()), shutil.disk_usage(root).free
        if size > 0.9 * free:
            raise OSError(f"{size:,} bytes, expected less than the {free:,} bytes that are free in {root.parent}")
        copy_of_all = root / place.address.replace("://", ":/")
        copies = [copy_of_all / place.relative(name) for name in found]
        for copy in copies:
            copy.parent.mkdir(parents=True, exist_ok=True)
        place.files.get(list(found), [str(copy) for copy in copies])
    return temporary, copy_of_all


@contextlib.contextmanager
def kept(folder: Path, request: Request) -> Iterator[None]:
    """Get what an address has of a run's folder, and at the end put there what is new, its records last.

    The folder itself stays, below the current one.

    Raises:
        BadOption: with shards, whose records an object store cannot append to each other.
        ValueError: there is no access; what was fitted is in the folder.
    """
    if request.shard:
        raise BadOption(
            f"--out {address_of(request.out)}: expected a folder with --shard; give each part its own --out."
        )
    place = opened(address_of(folder))
    with told(place.address):
        count = _get(place, folder)
    if count and not request.quiet:
        say(f"{count} files from {place.address}")
    before = _states(folder)
    try:
        yield
    finally:
        with told(place.address):
            there = place.files.find(place.name) if place.files.exists(place.name) else []
            known = {str(place.relative(name)) for name in there}
            after = _states(folder)
            new = [file for file in after if after[file] != before.get(file) or file not in known]
            for file in sorted(new, key=lambda file: file == RECORDS):
                place.files.put_file(str(folder / file), f"{place.name}/{file}")
        if not request.quiet:
            say(f"{len(new)} files put at {place.address}")


def _get(place: Place, folder: Path) -> int:
    """Copy what is missing in a run's folder; of records the lines, before those that are there."""
    names = place.files.find(place.name) if place.files.exists(place.name) else []
    for name in names:
        file = folder / place.relative(name)
        if file.name == RECORDS and file.exists():
            mine = read_bytes(file).splitlines()
            lines = [line for line in place.files.cat_file(name).splitlines() if line not in mine] + mine
            write_atomically(file, lambda target, lines=lines: target.write_bytes(b"\n".join(lines) + b"\n"))  # type: ignore[misc]
        elif not file.exists():
            write_atomically(file, lambda target, name=name: place.files.get_file(name, str(target)))  # type: ignore[misc]
    return len(names)


def _states(folder: Path) -> dict[str, tuple[int, int]]:
    """The size and time of each file below a folder."""
    files = [file for file in folder.rglob("*") if file.is_file() and not file.name.startswith(PARTIAL)]
    states = {file.relative_to(folder).as_posix(): file.stat() for file in files}
    return {name: (state.st_size, state.st_mtime_ns) for name, state in states.items()}


def _is_file(info: dict[str, object]) -> bool:
    return info["type"] == "file"


def _stamp(info: dict[str, object]) -> str:
    """Digests of the name and the size, as of a file, and of the version that a store states."""
    version = next((info[key] for key in VERSIONS if info.get(key)), "")
    texts = f"{PurePosixPath(str(info['name'])).name} {info['size']}", str(version)
    return "-".join(hashlib.sha256(text.encode()).hexdigest()[:6] for text in texts)
