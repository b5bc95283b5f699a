"""Files are there whole or not at all; fits are folders of such files."""

import errno
import itertools
import json
import multiprocessing
import os
import warnings
from collections.abc import Callable
from pathlib import Path, PureWindowsPath
from typing import Any

import pytest
import torch
from safetensors.torch import load_file

from metapp.runs.fit import read_fit
from metapp.runs.spec import Spec
from metapp.runs.stored_fits import read_fits, read_fits_of_spec
from metapp.storage.files import (
    PARTIAL_PREFIX,
    file_name,
    partial_path,
    printable_name,
    read_text,
    remove_partial,
    write_atomically,
)
from metapp.storage.fit_folders import PARAMS, RECORD, find_fit_folder, name_with_digest, read_params
from metapp.storage.folders import MARKER
from tests.kept_fits import fit_of, spec_with, write_fit


def test_a_text_has_line_ends_of_one_kind(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"a\r\nb\rc\n")
    assert read_text(tmp_path / "a") == (tmp_path / "a").read_text() == "a\nb\nc\n"


def test_replaced_files_are_kept_under_another_name(tmp_path: Path) -> None:
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
def test_after_a_kill_at_any_call_the_next_run_mends_all(tmp_path: Path, earlier: dict[str, str]) -> None:
    """The command, run again, leaves the files that it leaves without a kill."""
    for calls in itertools.count():
        folder = tmp_path / str(calls)
        folder.mkdir()
        for name, text in earlier.items():
            (folder / name).write_text(text)
        path, previous = folder / "start", folder / "previous"
        killed = write_until(path, previous, calls)
        if path.is_file():
            assert path.read_text() in (earlier.get("start"), "new")
        for unfinished in folder.glob(f"{PARTIAL_PREFIX}*"):
            os.utime(unfinished, (0, 0))
        remove_partial(folder)
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


def test_unfinished_files_of_killed_programs_are_removed(tmp_path: Path) -> None:
    path = tmp_path / "start.safetensors"
    left, left_folder, written = (partial_path(path) for _ in range(3))
    left_folder.mkdir()
    for file in (path, left, left_folder / path.name, written):
        file.touch()
    for unfinished in (path, left, left_folder):
        os.utime(unfinished, (0, 0))
    others = [tmp_path / f".partial-{name}" for name in ("results", "1a2b3c4d-of-a-link")]
    others[0].mkdir()
    others[1].symlink_to(others[0])
    for other in others:
        os.utime(other, (0, 0), follow_symlinks=False)
    remove_partial(tmp_path)
    assert sorted(tmp_path.iterdir()) == sorted([written, path, others[0]])  # a link goes, a user's folder stays


# Names

ODD = ["größe" * 60, "日" * 200, "a\nb", "x" * 101, "x" * 300, "AUX", "com1.measured", "gold."]
APART = ["gold", "a b", "a_b", "a/b", "a\\b", "..", ".", "", "/", ".hidden", "hidden", "-x", "task", "aux", *ODD]


@pytest.mark.parametrize("name", APART)
def test_names_of_files_and_tasks_are_safe_and_short(name: str) -> None:
    for make in (printable_name, file_name):
        safe_name = make(name)
        assert len(safe_name.encode()) <= 100
        assert safe_name.isprintable()
        assert make(safe_name) == safe_name
    assert {file_name(name)[0], file_name(name)[-1]}.isdisjoint(".")
    assert not set(file_name(name)) & set('/\\:*?"<>| ')
    assert not PureWindowsPath(file_name(name)).is_reserved()


def test_other_names_are_other_files_and_good_names_stay() -> None:
    assert len({file_name(name) for name in APART}) == len(APART)
    assert file_name("gold-1.5_x") == "gold-1.5_x"
    assert printable_name("x" * 101) != printable_name("x" * 102)
    for name in ("gold", "red felt/2", "größe", "x" * 100, ""):
        assert printable_name(name) == name


# Fits, a folder each


THETA = {"w": torch.arange(3.0)}


def names(run: Path) -> list[str]:
    return [fit.name for fit in read_fits(run)]


def test_a_fit_is_a_folder(tmp_path: Path) -> None:
    run = tmp_path / "run"
    assert read_fits(run) == []
    theta = {"w": torch.ones(2, 3, requires_grad=True).T}
    kept = write_fit(
        run, fit_of("red felt/2", note="größe\u2028\nx"), theta, lambda folder: (folder / "a.png").write_text("a")
    )
    folder = run / file_name("red felt/2")
    assert kept == fit_of("red felt/2", note="größe\u2028\nx")
    assert kept.folder == folder
    assert read_fits(run) == [kept]
    assert sorted(file.name for file in folder.iterdir()) == ["a.png", PARAMS, RECORD]
    assert torch.equal(load_file(folder / PARAMS)["w"], torch.ones(3, 2))
    assert {place.name for place in run.iterdir()} == {folder.name, MARKER}


def test_the_record_is_last_and_a_failed_fit_leaves_nothing(tmp_path: Path) -> None:
    seen = []

    def draw(folder: Path) -> None:
        seen.append((sorted(file.name for file in folder.iterdir()), names(tmp_path)))
        raise OSError(28, "No space left on device")

    with pytest.raises(OSError, match=rf"{tmp_path}: No space left on device; gold was not written; free some space"):
        write_fit(tmp_path, fit_of("gold"), THETA, draw)
    assert seen == [([PARAMS], [])]
    assert list(tmp_path.iterdir()) == [tmp_path / MARKER]
    write_fit(tmp_path, fit_of("gold", error=7.0), THETA)
    with pytest.raises(OSError, match="No space left"):
        write_fit(tmp_path, fit_of("gold"), THETA, draw)
    assert [fit.error for fit in read_fits(tmp_path)] == [7.0]


def test_each_input_has_one_fit_whatever_its_name(tmp_path: Path) -> None:
    # JSON has no such numbers
    nan: dict[str, Any] = {"further_errors": {"ssim": float("nan")}, "figures": {"curve": [(1, float("inf"))]}}
    for source, error in (("/a/wall.jpg", 1.0), ("/b/wall.jpg", 2.0), ("/a/wall.jpg", 3.0), ("/b/wall.jpg", 4.0)):
        write_fit(tmp_path, fit_of("wall", source, error=error, **nan), {"w": torch.tensor([error])})
    marked = name_with_digest("wall", "/b/wall.jpg")
    assert {fit.name: fit.error for fit in read_fits(tmp_path)} == {"wall": 3.0, marked: 4.0}
    assert {folder.name for folder in tmp_path.iterdir()} == {"wall", marked, MARKER}
    assert read_params(tmp_path / marked)["w"] == 4.0
    folder = find_fit_folder(tmp_path, "wall", "/b/wall.jpg")
    assert folder == tmp_path / marked
    found = read_fit(folder)
    assert (found.name, found.further_errors, found.figures) == (marked, {"ssim": None}, {"curve": [[1, None]]})
    assert find_fit_folder(tmp_path, "wall", "/c/wall.jpg") is None


def test_fits_of_other_specifications_and_batches_do_not_count(tmp_path: Path) -> None:
    ten, twenty = (spec_with(paradigm="meta", steps=steps, conditions={"fits": ("a", "b")}) for steps in (10, 20))
    for name in ("gold", "tin"):
        write_fit(tmp_path, fit_of(name, name, spec=ten), THETA)
    assert list(read_fits_of_spec(tmp_path, ten)) == ["gold", "tin"]
    assert read_fits_of_spec(tmp_path, twenty) == {}
    write_fit(tmp_path, fit_of("tin", "tin", spec=twenty), THETA)
    write_fit(tmp_path, fit_of("zinc", "zinc", spec=twenty, batch=4), THETA)  # its seconds are a share
    assert list(read_fits_of_spec(tmp_path, ten)) == ["gold"]
    assert list(read_fits_of_spec(tmp_path, twenty)) == ["tin"]
    assert names(tmp_path) == ["gold", "tin", "zinc"]


@pytest.mark.parametrize("name", ODD)
def test_a_name_of_any_kind_has_a_folder(tmp_path: Path, name: str) -> None:
    kept = write_fit(tmp_path, fit_of(name, name), THETA)
    assert kept.name == name
    assert torch.equal(read_params(kept.folder)["w"], THETA["w"])
    assert write_fit(tmp_path, fit_of(name, name), THETA).folder == kept.folder
    assert names(tmp_path) == [name]


def test_one_warning_names_the_first_record_that_is_none(tmp_path: Path) -> None:
    for name in ("gold", "tin", "zinc"):
        write_fit(tmp_path, fit_of(name), THETA)
    for name in ("gold", "zinc"):
        (tmp_path / name / RECORD).write_text("{")
    (tmp_path / "empty").mkdir()  # none, and no reason to say so
    (tmp_path / "pictures.png").touch()
    line = rf"gold/{RECORD}: no record, expected one of a fit \(.+\); .* 1 more in"
    with pytest.warns(UserWarning, match=line) as caught:
        assert names(tmp_path) == ["tin"]
    assert len(caught) == 1


def test_a_fit_that_is_being_written_is_not_read(tmp_path: Path) -> None:
    write_fit(tmp_path, fit_of("gold"), THETA)
    (tmp_path / "gold").rename(tmp_path / ".partial-1-a-gold")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert names(tmp_path) == []


def test_records_hold_the_whole_specification_and_nothing_that_is_not_set(tmp_path: Path) -> None:
    spec = spec_with(
        checkpoint=tmp_path / "a.safetensors", options={"conserve": True}, conditions={"precision": "half"}
    )
    kept = write_fit(tmp_path, fit_of("gold", spec=spec))
    written = json.loads((tmp_path / "gold" / RECORD).read_text())
    assert written.keys() == {"name", "settings", "error", "seconds", "source"}
    assert written["settings"] == spec.document()
    assert Spec.of_document(written["settings"]) == spec
    assert read_fits(tmp_path) == [kept]


def test_records_without_seconds_are_passed_over(tmp_path: Path) -> None:
    write_fit(tmp_path, fit_of("gold", seconds=None))
    with pytest.warns(UserWarning, match=r"gold: without seconds; passed over"):
        assert read_fits(tmp_path) == []


def at_once(writer: Callable[[Path, int], None], run: Path, count: int = 10) -> None:
    """Run `count` programs that write to a folder at the same time."""
    fork = multiprocessing.get_context("fork")
    writers = [fork.Process(target=writer, args=(run, number)) for number in range(count)]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
    assert [writer.exitcode for writer in writers] == [0] * count


def write_four(run: Path, number: int) -> None:
    for i in range(4):  # 40 inputs, of which four have each stem
        write_fit(run, fit_of(f"wall-{number}" if i % 2 else "wall", f"/{number}/{i}/x.jpg", note="x" * 10_000), THETA)


def write_the_same(run: Path, number: int) -> None:
    for name in "abcd":
        write_fit(run, fit_of(name, figures={"by": number}), {"w": torch.full((1000,), float(number))})


def test_ten_programs_write_at_once_and_lose_nothing(tmp_path: Path) -> None:
    at_once(write_four, tmp_path)
    fits = read_fits(tmp_path)
    assert {fit.source for fit in fits} == {f"/{i}/{k}/x.jpg" for i in range(10) for k in range(4)}
    assert len({fit.name for fit in fits}) == len(fits) == 40
    for fit in fits:
        assert torch.equal(read_params(fit.folder)["w"], THETA["w"])


def test_ten_programs_write_the_same_inputs_at_once(tmp_path: Path) -> None:
    at_once(write_the_same, tmp_path)
    assert names(tmp_path) == list("abcd")
    assert all(len(set(read_params(tmp_path / name)["w"].tolist())) == 1 for name in "abcd")
