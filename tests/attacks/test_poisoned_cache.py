"""Compiled code that somebody else may have put into the cache is not run."""

from __future__ import annotations

import os
import warnings
from pathlib import Path

import pytest

from metapp.extensions.native import compiler as module
from metapp.extensions.native.compiler import compiler, load
from metapp.storage.cache import cache_folder

ATTACKS = ("a folder of another user", "a linked folder", "a folder that all could write to")


@pytest.mark.skipif(compiler() is None, reason="no C compiler: apt-get install gcc libc6-dev")
@pytest.mark.parametrize("attack", ATTACKS)
def test_a_library_of_others_is_not_run(
    attack: str, cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A library that is compiled from another source, with a right digest, lies where ours would."""
    if "another user" in attack and os.getuid() != 0:
        pytest.skip("only root can give files away")
    monkeypatch.setattr(module, "cache_folder", cache_folder)
    source, native = tmp_path / "seven.c", cache / "native"
    source.write_text("int seven(void) { return 7; }\n")
    assert compiled(source, "seven") == 7
    (library,), (digest,) = (list(native.glob(f"seven-*.{suffix}")) for suffix in ("so", "sha256"))
    other = tmp_path / "other" / "seven.c"
    other.parent.mkdir()
    other.write_text("int seven(void) { return 666; }\n")
    assert compiled(other, "seven") == 666
    (bad,) = set(native.glob("seven-*.so")) - {library}
    bad.replace(library)
    digest.write_bytes(module._digest(library, library.read_bytes()))
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
