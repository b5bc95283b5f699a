"""Compiled C sources in the cache folder: whole, or compiled anew."""

from __future__ import annotations

import os
import stat
import warnings
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


ATTACKS = ("a folder of another user", "a linked folder", "a folder that all could write to")


@pytest.mark.skipif(compiler() is None, reason="no C compiler: apt-get install gcc libc6-dev")
@pytest.mark.parametrize("attack", ATTACKS)
def test_a_library_of_others_is_not_run(attack: str, cache: Path, tmp_path: Path) -> None:
    """A library that is compiled from another source, with its digest, lies where ours would."""
    if "another user" in attack and os.getuid() != 0:
        pytest.skip("only root can give files away")
    source, native = seven_of(tmp_path), cache / "native"
    assert compiled(source, "seven") == 7
    (library,), (digest,) = (list(native.glob(f"seven-*.{suffix}")) for suffix in ("so", "sha256"))
    other = tmp_path / "other" / "seven.c"
    other.parent.mkdir()
    other.write_text("int seven(void) { return 666; }\n")
    assert compiled(other, "seven") == 666
    (bad,) = set(native.glob("seven-*.so")) - {library}
    bad.replace(library)
    bad.with_suffix(".sha256").replace(digest)
    if attack == "a folder of another user":
        os.chown(native, 12345, 12345)
    elif attack == "a linked folder":
        native.rename(native.with_name("elsewhere"))
        native.symlink_to("elsewhere")
    else:
        native.chmod(0o777)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("default")
        assert compiled(source, "seven") == 7
        assert load.__wrapped__(source, "seven") is not None
    assert [str(each.message).partition(":")[0] for each in said] == [str(native)]
    assert "code is compiled for this run alone" in str(said[0].message)


def compiled(source: Path, name: str) -> int:
    """The result of a function, in a process of its own."""
    reading, writing = os.pipe()
    if (child := os.fork()) == 0:
        functions = load.__wrapped__(source, name)
        os.write(writing, str(functions and getattr(functions, name)()).encode())
        os._exit(0)
    os.close(writing)
    os.waitpid(child, 0)
    with open(reading, "rb") as file:
        return int(file.read())
