"""Fits of objects at addresses, and runs that are kept there; memory:// stands for an object store."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import metapp as toolkit
from metapp.extensions.addresses import access, store
from metapp.extensions.addresses.access import TEMPORARY, address_of
from metapp.storage.records import read_records

fsspec = pytest.importorskip("fsspec", reason="fsspec is not installed")
pytestmark = pytest.mark.usefixtures("compiled", "small_spheres")


@pytest.fixture
def memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """An object store of its own, a current folder, and a folder for copies, in which none may stay."""
    monkeypatch.chdir(tmp_path)
    copies = tmp_path / "temporary"
    copies.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(copies))
    files = fsspec.filesystem("memory")
    files.store.clear()
    files.pseudo_dirs[:] = [""]
    yield files
    access._copies.clear()
    files.store.clear()
    assert not list(copies.glob(f"{TEMPORARY}*"))


def put_networks(files: Any, folder: Path, place: str) -> None:
    """Networks as folders of three files each."""
    for file in folder.rglob("*.npy"):
        files.pipe_file(f"{place}/{file.relative_to(folder)}", file.read_bytes())


def put_rows(files: Any, place: str, seed: int) -> None:
    """A table of a goniometer."""
    rng = np.random.default_rng(seed)
    rows = [f"{rng.uniform(0, 80)},{rng.uniform(0, 360)},{rng.uniform(0, 80)},0,0.2,0.1,0.05" for _ in range(200)]
    head = "theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg,r,g,b"
    files.pipe_file(place, "\n".join([head, *rows]).encode())


def fit(metapp: Callable, *words: str) -> Any:
    return metapp("general", "brdf", "--recipe", "quick", "--json", *words)


def test_a_path_is_an_address_by_its_protocol(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert address_of(Path("s3://bucket/a/gold.binary")) == "s3://bucket/a/gold.binary"
    assert address_of(Path(f"/tmp/{TEMPORARY}x/gs:/bucket/a.exr")) == "gs://bucket/a.exr"
    for path in ("gold.binary", "/data/a:b.png", "c:/x", "a/b:/c"):
        assert address_of(Path(path)) == "", path
    Path("run:/x").mkdir(parents=True)
    assert address_of(Path("run:/x")) == ""


def test_objects_are_fitted_as_files_are(metapp: Callable, memory: Any) -> None:
    """One object, several by a pattern, and the same in Python; records and folders are named by the address."""
    for name, seed in (("a", 0), ("b", 1)):
        put_rows(memory, f"/bucket/{name}.csv", seed)
        Path(f"{name}.csv").write_bytes(memory.cat_file(f"/bucket/{name}.csv"))
    local = fit(metapp, "a.csv").done
    done = fit(metapp, "memory://bucket/a.csv").done
    assert done["tasks"][0]["error"] == local["tasks"][0]["error"]
    assert Path(done["out"]).name.startswith("a-")
    assert Path(done["out"]).name != Path(local["out"]).name
    (record,) = read_records(Path(done["out"]) / "record.jsonl")
    assert (record["name"], record["source"]) == ("a", "memory://bucket/a.csv")
    assert record["origin"]["inputs"] == ["memory://bucket/a.csv"]
    assert record["stamp"][:6] == read_records(Path(local["out"]) / "record.jsonl")[0]["stamp"][:6]
    assert toolkit.fit("brdf", "memory://bucket/a.csv", paradigm="general", recipe="quick").error == record["error"]
    both = fit(metapp, "memory://bucket/*.csv", "--batch", "2").done
    assert [task["name"] for task in both["tasks"]] == ["a", "b"]
    assert Path(both["out"]).name.startswith("bucket-")
    again = fit(metapp, "memory://bucket/*.csv", "--batch", "2")
    assert "2 fitted before" in again.err
    put_rows(memory, "/bucket/b.csv", 2)  # of another time
    assert "1 fitted before" in fit(metapp, "memory://bucket/*.csv", "--batch", "2").err


def test_the_folder_of_a_run_is_the_same_from_anywhere(metapp: Callable, memory: Any, tmp_path: Path) -> None:
    put_rows(memory, "/bucket/a.csv", 0)
    names = []
    for place in ("here", "there"):
        (tmp_path / place).mkdir()
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(tmp_path / place)
            names.append(Path(fit(metapp, "memory://bucket/a.csv").done["out"]).name)
    assert names[0] == names[1]


def test_recipes_are_chosen_by_objects_too(metapp: Callable, memory: Any) -> None:
    put_rows(memory, "/bucket/a.csv", 0)
    assert "recipe few" in metapp("meta", "brdf", "memory://bucket/a.csv").err


def test_folders_are_fitted_as_folders_are(metapp: Callable, memory: Any, neural_fits: Callable[[int], Path]) -> None:
    put_networks(memory, neural_fits(2), "/bucket/nets")
    told = fit(metapp, "memory://bucket/nets", "--quiet").done
    assert [task["name"] for task in told["tasks"]] == ["m0", "m1"]
    assert Path(told["out"]).name.startswith("nets-")
    sources = [record["source"] for record in read_records(Path(told["out"]) / "record.jsonl")]
    assert sources == ["memory://bucket/nets/m0", "memory://bucket/nets/m1"]
    access._copies.clear()  # of folders, at the end of the process


def test_lines_may_be_addresses(metapp: Callable, memory: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    put_rows(memory, "/bucket/a.csv", 0)
    monkeypatch.setattr(
        "metapp.cli.fits.command.lines_of_input", lambda: iter(["memory://bucket/a.csv", "memory://bucket/b.csv"])
    )
    result = metapp("general", "brdf", "-", "--recipe", "quick", "--json", "--quiet")
    first, second = map(json.loads, result.out.splitlines())
    assert first["tasks"][0]["name"] == "a"
    assert second["failure"] == "memory://bucket/b.csv: no such object or folder, expected an existing one."


def test_what_cannot_be_had_is_one_line(
    metapp: Callable, memory: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    memory.pipe_file("/bucket/torn.binary", b"x" * 1000)
    for address, line in (
        ("memory://bucket/no.csv", "memory://bucket/no.csv: no such object or folder, expected an existing one."),
        ("memory://bucket/*.exr", "memory://bucket/*.exr: no such object or folder, expected an existing one."),
        ("ftp://host/a.csv", "ftp://host/a.csv: no address that metapp reads, expected a path or one of s3://, "),
        ("memory://a::http://b/c", "memory://a::http:/b/c: no address that metapp reads, expected a path or one of"),
        ("memory://bucket/torn.binary", "memory://bucket/torn.binary: 1,000 bytes, expected 34,992,012"),
    ):
        assert fit(metapp, address).error.startswith(f"error: {line}"), address
    monkeypatch.setitem(store.PROTOCOLS, "s3", "s3fs_that_is_missing")
    missing = "s3://bucket/a.csv: needs the package s3fs_that_is_missing: pip install s3fs_that_is_missing"
    assert fit(metapp, "s3://bucket/a.csv").error == f"error: {missing}"

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError("Forbidden")

    put_rows(memory, "/bucket/a.csv", 0)
    monkeypatch.setattr(type(memory), "get_file", refuse)
    denied = "memory://bucket/a.csv: access denied (Forbidden); set the credentials of memory."
    assert fit(metapp, "memory://bucket/a.csv").error == f"error: {denied}"
    monkeypatch.setattr(shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(1, 1, 100))
    assert "bytes, expected less than the 100 bytes that are free" in fit(metapp, "memory://bucket/a.csv").error


def test_names_do_not_lead_out_of_the_copy(metapp: Callable, memory: Any, tmp_path: Path) -> None:
    memory.store["/bucket/nets/../../../evil.npy"] = memory.store.get("", None) or _file(memory, b"x")
    assert "leads out of its folder" in fit(metapp, "memory://bucket/nets").error
    assert not list(tmp_path.rglob("evil.npy"))


def _file(files: Any, content: bytes) -> Any:
    files.pipe_file("/other", content)
    return files.store.pop("/other")


def test_runs_are_kept_at_an_address(metapp: Callable, memory: Any, tmp_path: Path) -> None:
    """What is there counts as done on another machine; what is new is put there, records last."""
    for name, seed in (("a", 0), ("b", 1), ("c", 2)):
        put_rows(memory, f"/data/{name}.csv", seed)
    words = ("memory://data/*.csv", "--batch", "2", "--out", "memory://bucket/runs")
    first = fit(metapp, *words).done
    place = "/bucket/" + first["out"].partition("memory:/bucket/")[2]
    stored = memory.find(place)
    assert {f"{place}/{name}" for name in ("record.jsonl", "params/a.safetensors", "gallery.html")} <= set(stored)
    shutil.rmtree("memory:")  # another machine
    put_rows(memory, "/data/b.csv", 3)
    second = fit(metapp, *words)
    assert "2 fitted before" in second.err
    assert f"files from memory:/{place}" in second.err
    assert first["tasks"][0]["error"] == second.done["tasks"][0]["error"]
    records = [json.loads(line) for line in memory.cat_file(f"{place}/record.jsonl").splitlines()]
    assert [record["name"] for record in records] == ["a", "b", "c", "b"]
    third = fit(metapp, *words)
    assert "3 fitted before" in third.err
    assert metapp("general", "brdf", *words[:1], "--shard", "1/2", *words[3:]).misuse.startswith("Error: ")


def test_a_picture_is_a_texture_from_anywhere(metapp: Callable, memory: Any) -> None:
    """A file is read by its content, not only by its name."""
    pixels = np.random.default_rng(0).integers(0, 255, (80, 80, 3), np.uint8)
    Image.fromarray(pixels).save("wall.png")
    memory.pipe_file("/photos/wall.png", Path("wall.png").read_bytes())
    fits = [
        toolkit.fit("texture", place, paradigm="overfit", recipe="quick", steps=1)
        for place in ("wall.png", "memory://photos/wall.png")
    ]
    np.testing.assert_array_equal(*(each.parameters["z"].numpy() for each in fits))
