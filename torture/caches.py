"""The cache of compiled libraries as others may leave it: the function is the right one, or torch is used."""

from __future__ import annotations

import functools
import os
import random
import shutil
from pathlib import Path

from torture.child import BadResult, in_child, place_of_process, remove
from torture.mutate import mutate_bytes
from torture.seeds import Files

OTHER = 12345  # a user
RIGHT, WRONG = 7, 66  # what the function of ours and that of others gives
CASE = "case"


def cases() -> list[Files]:
    """None, as all are drawn; what they are made of is compiled now."""
    _libraries()
    return []


@functools.cache
def _libraries() -> dict[str, Path]:
    """Folders of sources and caches: of ours, of another function, and of another source with the same function."""
    place, folders = place_of_process(), {}
    for name, function, value in (("ours", "seven", RIGHT), ("eight", "eight", 8), ("others", "seven", WRONG)):
        folders[name] = place / name
        folders[name].mkdir()
        (folders[name] / "seven.c").write_text(f"int {function}(void) {{ return {value}; }}\n")
        _load(folders[name], folders[name] / "cache", function)
    return folders


def _load(place: Path, cache: Path, function: str = "seven") -> int:
    """What the function gives, loaded in a process of its own; 0 for no library."""
    from metapp.extensions.native.compiler import load

    def work() -> int:
        os.environ["METAPP_CACHE"] = str(cache)
        functions = load.__wrapped__(place / "seven.c", function)
        return int(getattr(functions, function)()) if functions else 0

    return in_child(place / "said", work)


def write(rng: random.Random, folder: Path) -> Path:
    """Some accidents in a cache, then sometimes an attack: a library of another source, with its digest, as ours."""
    native = folder / "cache" / "native"
    shutil.copytree(_libraries()["ours"] / "cache", native.parent)
    (library,) = native.glob("*.so")
    files = [library, library.with_suffix(".sha256")]
    for _ in range(rng.choice((0, 1, 1, 2, 3))):
        _have_accident(rng, native, files)
    if rng.random() < 0.5 and native.is_dir() and not native.is_symlink():
        _attack(rng, native, files)
    (folder / CASE).touch()
    return folder / CASE


def _have_accident(rng: random.Random, native: Path, files: list[Path]) -> None:
    """Change one thing, but nothing that a link of an earlier accident leads to."""
    kind, file = rng.randrange(7), rng.choice(files)
    if native.is_symlink() or not native.is_dir():
        return
    whole = [path for path in files if path.is_file() and not path.is_symlink()]
    if kind == 0 and file in whole:
        file.write_bytes(mutate_bytes(rng, file.read_bytes(), [path.read_bytes() for path in whole]))
    elif kind == 1 and file in whole:
        os.truncate(file, rng.randrange(file.stat().st_size + 2))
    elif kind == 2:
        _place(rng.choice(("eight", "others")), files[: rng.choice((1, 2))])
    elif kind == 3:
        path = rng.choice([native.parent, native, *whole])
        path.chmod(rng.randrange(0o2000) | (0o700 if path.is_dir() else 0))
    elif kind == 4:
        _become(rng, file)
    elif kind == 5 and rng.random() < 0.3:
        _become(rng, native)
    elif kind == 6 and os.getuid() == 0:
        os.chown(rng.choice([native, *whole]), OTHER, OTHER)


def _place(name: str, files: list[Path]) -> None:
    """Put the files of another cache in the place of these."""
    for file in files:
        remove(file)
        shutil.copy(next((_libraries()[name] / "cache" / "native").glob(f"*{file.suffix}")), file)


def _become(rng: random.Random, path: Path) -> None:
    """Make something else of a file or folder."""
    remove(path)
    kind = rng.randrange(6)
    if kind == 0:
        path.mkdir()
    elif kind == 1:
        os.mkfifo(path)
    elif kind == 2:
        path.write_bytes(rng.randbytes(20))
    elif kind < 5:
        path.symlink_to(rng.choice(("none", path.name, "..", "/dev/zero")))


def _attack(rng: random.Random, native: Path, files: list[Path]) -> None:
    """Leave a wrong library that is not the user's own by one sign at least."""
    _place("others", files)
    sign = rng.randrange(6) if os.getuid() == 0 else rng.randrange(4)
    if sign == 0:
        native.parent.chmod(0o777)
    elif sign == 1:
        native.rename(native.with_name("elsewhere"))
        native.symlink_to("elsewhere")
    elif sign == 2:
        file = rng.choice(files)
        file.chmod(0o600 | rng.choice((0o020, 0o002, 0o022, 0o066, 0o077)))
    elif sign == 3:
        file = rng.choice(files)
        file.rename(file.with_suffix(".bak"))
        file.symlink_to(file.with_suffix(".bak"))
    else:
        os.chown(native if sign == 4 else rng.choice(files), OTHER, OTHER)


def read(folder: Path, file: Path) -> None:
    """As an engine does."""
    value = _load(_libraries()["ours"], folder / "cache")
    if value not in (RIGHT, 0):
        raise BadResult(f"a function that gives {value}")
