"""Fits on disk, a folder each."""

from __future__ import annotations

import json
import multiprocessing
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import load_file

from metapp.storage.files import as_text, file_name
from metapp.storage.fits import (
    FIT,
    PARAMS,
    RECORD,
    Fits,
    find_fit,
    marked_name,
    read_fits,
    read_params,
    write_fit,
)
from tests.storage.test_files import ODD

THETA = {"w": torch.arange(3.0)}


def record(name: str, source: str = "", **more: Any) -> dict[str, Any]:
    return {"name": name, "source": source or f"/in/{name}.csv", "error": 0.5, "seconds": 0.1, **more}


def names(run: Path) -> list[str]:
    return [each["name"] for each in read_fits(run)]


def test_a_fit_is_a_folder(tmp_path: Path) -> None:
    fits = Fits(tmp_path / "run", {"steps": 10}, FIT, {"data": "/d"})
    assert fits.records() == {}
    theta = {"w": torch.ones(2, 3, requires_grad=True).T}
    kept = fits.write(record("red felt/2", note="größe\u2028\nx"), theta, lambda at: (at / "a.png").write_text("a"))
    folder = tmp_path / "run" / file_name("red felt/2")
    own = {"settings": {"steps": 10}, "origin": {"data": "/d"}, "folder": str(folder)}
    assert kept == record("red felt/2", note="größe\u2028\nx") | own
    assert read_fits(tmp_path / "run") == [kept]
    assert sorted(file.name for file in folder.iterdir()) == ["a.png", PARAMS, RECORD]
    assert torch.equal(load_file(folder / PARAMS)["w"], torch.ones(3, 2))
    assert [place.name for place in (tmp_path / "run").iterdir()] == [folder.name]


def test_the_record_is_written_last_and_a_fit_that_fails_leaves_nothing(tmp_path: Path) -> None:
    seen = []

    def draw(folder: Path) -> None:
        seen.append((sorted(file.name for file in folder.iterdir()), names(tmp_path)))
        raise OSError(28, "No space left on device")

    with pytest.raises(OSError, match=rf"{tmp_path}: No space left on device; gold was not written; free some space"):
        write_fit(tmp_path, record("gold"), THETA, draw)
    assert seen == [([PARAMS], [])]
    assert list(tmp_path.iterdir()) == []
    write_fit(tmp_path, record("gold", error=7.0), THETA)
    with pytest.raises(OSError, match="No space left"):
        write_fit(tmp_path, record("gold"), THETA, draw)
    assert [each["error"] for each in read_fits(tmp_path)] == [7.0]


def test_the_same_input_replaces_its_fit_and_another_of_its_name_has_a_folder_of_its_own(tmp_path: Path) -> None:
    nan = {"ssim": float("nan"), "curve": [(1, float("inf"))]}  # JSON has no such numbers
    for source, error in (("/a/wall.jpg", 1.0), ("/b/wall.jpg", 2.0), ("/a/wall.jpg", 3.0), ("/b/wall.jpg", 4.0)):
        write_fit(tmp_path, record("wall", source, error=error, **nan), {"w": torch.tensor([error])})
    marked = marked_name("wall", "/b/wall.jpg")
    assert {each["name"]: each["error"] for each in read_fits(tmp_path)} == {"wall": 3.0, marked: 4.0}
    assert {each.name for each in tmp_path.iterdir()} == {"wall", marked}
    assert read_params(tmp_path / marked)["w"] == 4.0
    found = find_fit(tmp_path, "wall", "/b/wall.jpg")
    assert found is not None
    assert (found["name"], found["ssim"], found["curve"]) == (marked, None, [[1, None]])
    assert find_fit(tmp_path, "wall", "/c/wall.jpg") is None


def test_fits_of_other_settings_and_batches_do_not_count(tmp_path: Path) -> None:
    ten, twenty = (Fits(tmp_path, {"steps": steps, "fits": ("a", "b")}) for steps in (10, 20))
    for name in ("gold", "tin"):
        ten.write(record(name, name), THETA)
    assert list(ten.records()) == ["gold", "tin"]
    twenty.write(record("tin", "tin"), THETA)
    twenty.write(record("zinc", "zinc", batch=4), THETA)  # its seconds are a share
    assert list(ten.records()) == ["gold"]
    assert list(twenty.records()) == ["tin"]
    assert names(tmp_path) == ["gold", "tin", "zinc"]


@pytest.mark.parametrize("name", ODD)
def test_a_name_of_any_kind_has_a_folder(tmp_path: Path, name: str) -> None:
    kept = write_fit(tmp_path, record(name, name), THETA)
    assert kept["name"] == as_text(name)
    assert torch.equal(read_params(kept["folder"])["w"], THETA["w"])
    assert write_fit(tmp_path, record(name, name), THETA) == kept
    assert names(tmp_path) == [as_text(name)]


def test_names_in_records_of_others_turn_no_text(tmp_path: Path) -> None:
    given = ["a\u202egnp.b", "z\u200bw", "\u0639\u0631\u0628\u064a", "e\u0301tude"]
    for i, name in enumerate(given):
        (tmp_path / f"{i}").mkdir()
        (tmp_path / f"{i}" / RECORD).write_text(json.dumps({"name": name}))
    assert names(tmp_path) == ["a_gnp.b", "z_w", *given[2:]]


def test_one_warning_names_the_first_record_that_is_none(tmp_path: Path) -> None:
    for name in ("gold", "tin", "zinc"):
        write_fit(tmp_path, record(name), THETA)
    for name in ("gold", "zinc"):
        (tmp_path / name / RECORD).write_text("{")
    (tmp_path / "empty").mkdir()  # none, and no reason to say so
    (tmp_path / "pictures.png").touch()
    with pytest.warns(UserWarning, match=rf"gold/{RECORD}: no record, expected one of a task; .* 1 more in") as caught:
        assert names(tmp_path) == ["tin"]
    assert len(caught) == 1


def test_a_fit_that_is_being_written_is_not_read(tmp_path: Path) -> None:
    write_fit(tmp_path, record("gold"), THETA)
    (tmp_path / "gold").rename(tmp_path / ".partial-1-a-gold")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert names(tmp_path) == []


def at_once(writer: Callable[[Path, int], None], run: Path, count: int = 10) -> None:
    """Run `count` programs that write to a folder at the same time."""
    fork = multiprocessing.get_context("fork")
    writers = [fork.Process(target=writer, args=(run, number)) for number in range(count)]
    for each in writers:
        each.start()
    for each in writers:
        each.join()
    assert [each.exitcode for each in writers] == [0] * count


def write_four(run: Path, number: int) -> None:
    for i in range(4):  # 40 inputs, of which four have each stem
        write_fit(run, record(f"wall-{number}" if i % 2 else "wall", f"/{number}/{i}/x.jpg", note="x" * 10_000), THETA)


def write_the_same(run: Path, number: int) -> None:
    for name in "abcd":
        write_fit(run, record(name, by=number), {"w": torch.full((1000,), float(number))})


def test_ten_programs_write_at_once_and_lose_nothing(tmp_path: Path) -> None:
    at_once(write_four, tmp_path)
    records = read_fits(tmp_path, FIT)
    assert {each["source"] for each in records} == {f"/{i}/{k}/x.jpg" for i in range(10) for k in range(4)}
    assert len({each["name"] for each in records}) == len(records) == 40
    for each in records:
        assert torch.equal(read_params(each["folder"])["w"], THETA["w"])


def test_ten_programs_write_the_same_inputs_at_once(tmp_path: Path) -> None:
    at_once(write_the_same, tmp_path)
    assert names(tmp_path) == list("abcd")
    assert all(len(set(read_params(tmp_path / name)["w"].tolist())) == 1 for name in "abcd")
