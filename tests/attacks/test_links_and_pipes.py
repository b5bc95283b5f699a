"""Links and pipes among a user's files: what is written follows no link, what is read is a regular file."""

import os
import warnings
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from msgspec.structs import replace

from metapp.extensions.native import compiler as module
from metapp.extensions.native.compiler import find_compiler, load_library
from metapp.runs.stored_fits import read_fits
from metapp.storage.cache_folders import cache_folder
from metapp.storage.files import (
    check_readable,
    open_regular,
    read_bytes,
    read_text,
)
from metapp.storage.fit_folders import PARAMS, RECORD
from tests.kept_fits import fit_of, write_fit

KEYS = "first\nlast"
GOLD = fit_of("gold", error=1.0)
THETA = {"w": torch.zeros(1)}


@pytest.fixture
def keys(tmp_path: Path) -> Path:
    """A file elsewhere, which a folder that somebody sent must not reach."""
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "keys").write_text(KEYS)
    return tmp_path / "home" / "keys"


@pytest.fixture
def sent(tmp_path: Path) -> Path:
    (tmp_path / "sent").mkdir()
    return tmp_path / "sent"


@pytest.mark.parametrize("name", [RECORD, PARAMS])
@pytest.mark.parametrize("link", [Path.symlink_to, Path.hardlink_to])
def test_a_linked_record_does_not_cut_another_file(sent: Path, keys: Path, name: str, link: Callable) -> None:
    """The link is replaced by a file of the folder, and the file that it led to is unchanged."""
    write_fit(sent, GOLD, THETA)
    file = sent / "gold" / name
    content = file.read_bytes()
    (keys.write_bytes if name == RECORD else keys.write_text)(content if name == RECORD else KEYS)
    before = keys.read_bytes()
    file.unlink()
    link(file, keys)
    kept = write_fit(sent, replace(GOLD, error=2.0), THETA)
    assert (kept.folder, file.is_symlink(), file.stat().st_nlink) == (sent / "gold", False, 1)
    assert keys.read_bytes() == before
    assert [fit.error for fit in read_fits(sent)] == [2.0]


def test_nothing_is_written_into_a_linked_folder(sent: Path, keys: Path) -> None:
    (sent / "gold").symlink_to(keys.parent)
    write_fit(keys.parent.parent, replace(GOLD, name="home"), THETA)  # even where a fit is
    kept = write_fit(sent, GOLD, THETA)
    assert kept.name.startswith("gold-")
    assert (sent / kept.name / RECORD).is_file()
    assert [path.name for path in keys.parent.iterdir()] == ["keys"]


@pytest.mark.parametrize("read", [open_regular, read_bytes, read_text])
def test_pipes_and_devices_are_not_read(read: Callable, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path("/dev/zero")):
        with pytest.raises(ValueError, match="a pipe or device, expected a file"):
            read(path)
        with pytest.raises(ValueError, match="a pipe or device, expected a file"):
            check_readable(path)
    with pytest.raises(IsADirectoryError, match="a folder, expected a file"):
        read(tmp_path)
    with pytest.raises(FileNotFoundError):
        read(tmp_path / "none")


PIPES = {
    "brdf": ("a.binary", "a.csv", "a.bsdf"),
    "texture": ("a.png",),
    "svbrdf_nonstationary": ("a;b.png",),
    "illumination": ("a.exr", "a.png"),
    "transport": ("a.xml", "a.json"),
}


@pytest.mark.parametrize(("app", "name"), [(app, name) for app, names in PIPES.items() for name in names])
def test_a_pipe_among_inputs_does_not_hang(metapp: Callable, sent: Path, app: str, name: str) -> None:
    os.mkfifo(sent / name)
    assert f"{name}: a pipe or device, expected a file" in metapp("overfit", app, sent / name, "--quiet").error


# Compiled code that somebody else may have put into the cache is not run


ATTACKS = ("a folder of another user", "a linked folder", "a folder that all could write to")


@pytest.mark.skipif(find_compiler() is None, reason="no C compiler: apt-get install gcc libc6-dev")
@pytest.mark.parametrize("attack", ATTACKS)
def test_libraries_that_other_users_can_write_are_not_run(
    attack: str, cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A library that is compiled from another source lies where ours would."""
    if "another user" in attack and os.getuid() != 0:
        pytest.skip("only root can give files away")
    monkeypatch.setattr(module, "cache_folder", cache_folder)
    source, native = tmp_path / "seven.c", cache / "native"
    source.write_text("int seven(void) { return 7; }\n")
    assert call_in_new_process(source, "seven") == 7
    (library,) = native.glob("seven-*.so")
    other = tmp_path / "other" / "seven.c"
    other.parent.mkdir()
    other.write_text("int seven(void) { return 666; }\n")
    assert call_in_new_process(other, "seven") == 666
    (bad,) = set(native.glob("seven-*.so")) - {library}
    bad.replace(library)
    if attack == "a folder of another user":
        os.chown(native, 12345, 12345)
    elif attack == "a linked folder":
        native.rename(native.with_name("elsewhere"))
        native.symlink_to("elsewhere")
    else:
        native.chmod(0o777)
    with warnings.catch_warnings(record=True) as messages:
        warnings.simplefilter("default")
        assert call_in_new_process(source, "seven") == 7
        assert load_library.__wrapped__(source, "seven") is not None
    assert [str(warning.message).partition(":")[0] for warning in messages] == [str(native)]
    assert "code is compiled for this run alone" in str(messages[0].message)


def call_in_new_process(source: Path, name: str) -> int:
    """The result of a function, in a process of its own."""
    reading, writing = os.pipe()
    if (child := os.fork()) == 0:
        functions = load_library.__wrapped__(source, name)
        os.write(writing, str(functions and getattr(functions, name)()).encode())
        os._exit(0)
    os.close(writing)
    os.waitpid(child, 0)
    with open(reading, "rb") as file:
        return int(file.read())
