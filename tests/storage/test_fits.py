"""Files are there whole or not at all."""

import errno
import itertools
import os
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from metapp.storage.files import file_name, read_text, remove_partial, safe_name, write_atomically


def test_a_text_has_line_ends_of_one_kind(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"a\r\nb\rc\n")
    assert read_text(tmp_path / "a") == (tmp_path / "a").read_text() == "a\nb\nc\n"


def test_what_is_replaced_is_kept_under_another_name(tmp_path: Path) -> None:
    path, previous = tmp_path / "start", tmp_path / "previous"
    for text in ("one", "two", "three"):
        write_atomically(path, lambda partial, text=text: partial.write_text(text), previous)
        assert path.read_text() == text
    assert previous.read_text() == "two"

    def fail(partial: Path) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.raises(OSError, match="No space left"):
        write_atomically(path, fail, previous)
    assert (path.read_text(), previous.read_text()) == ("three", "two")
    # killed after the old file got its second name: both are one file
    previous.unlink()
    previous.hardlink_to(path)
    write_atomically(path, lambda partial: partial.write_text("four"), previous)
    assert (path.read_text(), previous.read_text()) == ("four", "three")
    assert sorted(tmp_path.iterdir()) == [previous, path]


CALLS = ("open", "fsync", "link", "replace", "unlink")  # of the system, by which a file is written


def write_until(path: Path, previous: Path, calls: float) -> bool:
    """Write a file in a fork that is killed before its so many-th call of the system; whether it was."""
    if child := os.fork():
        return os.waitpid(child, 0)[1] != 0
    try:
        done = itertools.count()
        for name in CALLS:
            call = getattr(os, name)
            setattr(os, name, lambda *a, of=call, **b: os._exit(1) if next(done) >= calls else of(*a, **b))
        write_atomically(path, lambda partial: partial.write_text("new"), previous)
    finally:
        os._exit(0)


@pytest.mark.parametrize("earlier", [{}, {"start": "old"}, {"start": "old", "previous": "older"}])
def test_a_kill_at_any_call_leaves_nothing_that_the_next_run_does_not_mend(
    tmp_path: Path, earlier: dict[str, str]
) -> None:
    """The same command again leaves the same files as one that was never killed."""
    for calls in itertools.count():
        folder = tmp_path / str(calls)
        folder.mkdir()
        for name, text in earlier.items():
            (folder / name).write_text(text)
        path, previous = folder / "start", folder / "previous"
        killed = write_until(path, previous, calls)
        if path.is_file():
            assert path.read_text() in (earlier.get("start"), "new")
        remove_partial(path)
        remove_partial(previous)
        write_atomically(path, lambda partial: partial.write_text("new"), previous)
        found = {file.name: file.read_text() for file in folder.iterdir()}
        assert found == {"start": "new"} | ({"previous": earlier["start"]} if earlier else {}), calls
        if not killed:
            break
    assert calls >= 5


@pytest.mark.parametrize(
    "error",
    [
        OSError(errno.ENOSPC, "No space left on device"),
        OSError(errno.EDQUOT, "Disk quota exceeded"),
        PermissionError(errno.EACCES, "Permission denied"),
    ],
)
def test_failed_writes_name_the_folder(error: Exception, tmp_path: Path) -> None:
    def fail(partial: Path) -> None:
        partial.write_text("half")
        raise error

    with pytest.raises(OSError, match="not written; ") as caught:
        write_atomically(tmp_path / "map.exr", fail)
    assert str(caught.value).startswith(f"{tmp_path}: ")
    assert "map.exr" in str(caught.value)
    assert caught.value.errno in (errno.ENOSPC, errno.EDQUOT, errno.EACCES)
    assert not list(tmp_path.iterdir())


def test_errors_about_other_things_stay_as_they_are(tmp_path: Path) -> None:
    def fail(partial: Path) -> None:
        (tmp_path / "elsewhere" / "texture.png").read_bytes()

    with pytest.raises(FileNotFoundError, match=r"elsewhere/texture\.png"):
        write_atomically(tmp_path / "map.exr", fail)


def test_what_dead_programs_left_is_removed(tmp_path: Path) -> None:
    path = tmp_path / "start.safetensors"
    dead = 2**22 + 1  # above the largest process id of Linux
    left = tmp_path / f".partial-{dead}-start.safetensors"
    running = tmp_path / f".partial-{os.getppid()}-start.safetensors"
    other = tmp_path / f".partial-{dead}-other.safetensors"
    for each in (left, running, other):
        each.touch()
    remove_partial(path)
    assert sorted(tmp_path.iterdir()) == sorted([running, other])


# Names

ANY = st.characters(exclude_categories=["Zs"]) | st.sampled_from(" ./\\\ud800\x1b\u2028")
ODD = ["größe" * 60, "日" * 200, "\x1b[31mred", "caf\udce9", "a\u2028b", "x" * 101]
APART = ["gold", "a b", "a_b", "a/b", "a\\b", "..", ".", "", "/", ".hidden", "hidden", "a\0b", "-x", "task", *ODD]


@settings(max_examples=200, derandomize=True, database=None, deadline=None)
@given(st.text(ANY, max_size=150))
def test_names_of_files_and_tasks_are_safe_and_short(name: str) -> None:
    for make in (safe_name, file_name):
        safe = make(name)
        assert len(safe.encode()) <= 100
        assert safe.isprintable()
        assert make(safe) == safe
    assert file_name(name)[0] != "."
    assert not set(file_name(name)) & set('/\\:*?"<>| \0')


def test_other_names_are_other_files_and_good_names_stay() -> None:
    assert len({file_name(name) for name in APART}) == len(APART)
    assert file_name("gold-1.5_x") == "gold-1.5_x"
    assert safe_name("x" * 101) != safe_name("x" * 102)
    for name in ("gold", "red felt/2", "größe", "x" * 100, ""):
        assert safe_name(name) == name
