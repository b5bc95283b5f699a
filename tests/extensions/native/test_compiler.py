"""Compiled C sources in the cache folder: whole, or compiled anew."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from metapp.extensions.native import compiler as module
from metapp.extensions.native.compiler import compiler, load
from metapp.storage.cache import cache_folder


@pytest.fixture(autouse=True)
def _own_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    """These look at what is kept."""
    monkeypatch.setattr(module, "cache_folder", cache_folder)


@pytest.mark.skipif(compiler() is None, reason="no C compiler: apt-get install gcc libc6-dev")
@pytest.mark.parametrize(
    "damage", ["whole", "truncated", "a flipped bit", "no digest", "a digest that is no text", "another library"]
)
def test_a_damaged_library_is_compiled_anew(damage: str, cache: Path, tmp_path: Path) -> None:
    source = tmp_path / "seven.c"
    source.write_text("int seven(void) { return 7; }\n")
    if (child := os.fork()) == 0:  # the library is loaded elsewhere: damage to one that is loaded ends a process
        os._exit(load.__wrapped__(source, "seven") is None)
    assert os.waitpid(child, 0)[1] == 0
    (library,), (digest,) = (list((cache / "native").glob(f"seven-*.{suffix}")) for suffix in ("so", "sha256"))
    content, compiled_at = library.read_bytes(), library.stat().st_mtime_ns
    if damage == "truncated":
        os.truncate(library, len(content) // 2)
    elif damage == "a flipped bit":
        library.write_bytes(content[:-9] + bytes([content[-9] ^ 1]) + content[-8:])
    elif damage == "no digest":
        digest.unlink()
    elif damage == "a digest that is no text":
        digest.write_bytes(b"\xff" * 64)
    elif damage == "another library":
        other = tmp_path / "eight.c"
        other.write_text("int eight(void) { return 8; }\n")
        load.__wrapped__(other, "eight")
        (eight,) = (cache / "native").glob("eight-*.so")
        eight.replace(library)
        eight.with_suffix(".sha256").replace(digest)
    functions = load.__wrapped__(source, "seven")
    assert functions is not None
    assert functions.seven() == 7
    assert (library.stat().st_mtime_ns == compiled_at) == (damage == "whole")
    assert sorted(path.suffix for path in (cache / "native").iterdir()) == [".sha256", ".so"]


def seven_of(folder: Path) -> Path:
    source = folder / "seven.c"
    source.write_text("int seven(void) { return 7; }\n")
    return source


@pytest.mark.skipif(compiler() is None, reason="no C compiler: apt-get install gcc libc6-dev")
def test_the_folder_is_the_users_alone(cache: Path, tmp_path: Path) -> None:
    (cache / "native").mkdir(parents=True)
    (cache / "native").chmod(0o755)
    assert load.__wrapped__(seven_of(tmp_path), "seven") is not None
    assert stat.S_IMODE((cache / "native").stat().st_mode) == 0o700
