"""`metapp pack` and `metapp unpack`: fits as quantised differences from the checkpoint, end to end."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from metapp.runs.checks import shipped_path
from metapp.runs.pack import GROWTH
from metapp.storage.packing import read_pack, write_pack
from metapp.storage.records import load_checkpoint, read_records, read_theta, save_checkpoint

pytestmark = pytest.mark.usefixtures("small_spheres")


@pytest.fixture(scope="module")
def networks(neural_fits: Callable[[int], Path]) -> Path:
    return neural_fits(4)


@pytest.fixture
def fitted(metapp: Callable, networks: Path, tmp_path: Path) -> Callable[..., Path]:
    def fit(paradigm: str, *more: str) -> Path:
        words = (
            paradigm,
            "brdf",
            networks,
            "--recipe",
            "quick",
            "--out",
            tmp_path / "runs",
            "--json",
            "--quiet",
            *more,
        )
        return Path(metapp(*words).document["out"])

    return fit


@pytest.mark.parametrize("rule", ["ridge", "meta-adam"])
def test_a_pack_is_small_and_its_error_grows_by_a_hundredth(
    metapp: Callable, fitted: Callable, rule: str, tmp_path: Path
) -> None:
    run = fitted("meta", "--rule", rule)
    result = metapp("pack", run, "--out", tmp_path / "a.pack", "--json")
    assert result.code == 0
    told = result.document
    assert told["size"] == (tmp_path / "a.pack").stat().st_size < 4 * 4 * 675
    assert told["after"] - told["before"] <= GROWTH * told["before"]
    errors = [record["error"] for record in read_records(run / "record.jsonl")]
    assert told["before"] == pytest.approx(sum(errors) / 4, rel=1e-6)
    assert f"{told['size']:,} bytes" in result.err
    fewer = metapp("pack", run, "--out", tmp_path / "b.pack", "--bits", told["bits"] - 1, "--json").document
    assert fewer["after"] - fewer["before"] > GROWTH * fewer["before"]


@pytest.mark.parametrize("state", ["there", "moved", "older records", "changed"])
def test_inputs_of_a_run_of_many_are_found(metapp: Callable, networks: Path, tmp_path: Path, state: str) -> None:
    """Its records tell each input from others; where it was moved to is said after RUN."""
    materials = shutil.copytree(networks, tmp_path / "materials")
    words = ("--recipe", "quick", "--rule", "ridge", "--batch", "2", "--out", tmp_path / "runs", "--json", "--quiet")
    run = Path(metapp("meta", "brdf", materials, *words).document["out"])
    records, given = read_records(run / "record.jsonl"), ()
    if state == "moved":
        given = (materials.rename(tmp_path / "moved"),)
    elif state == "older records":
        lines = [json.dumps({key: value for key, value in each.items() if key != "origin"}) for each in records]
        (run / "record.jsonl").write_text("\n".join(lines) + "\n")
    elif state == "changed":
        shutil.rmtree(materials / "m0")
        shutil.copytree(materials / "m1", materials / "m0")
        records = records[1:]
    result = metapp("pack", run, *given, "--json")
    assert result.code == 0, result.err
    assert result.document["before"] == pytest.approx(sum(each["error"] for each in records) / len(records), rel=1e-6)
    assert result.document["after"] <= (1 + GROWTH) * result.document["before"]
    assert ("note: errors of 3 of 4 fits" in result.err) == (state == "changed")


def test_an_unpacked_run_is_a_run(metapp: Callable, fitted: Callable, tmp_path: Path) -> None:
    run = fitted("meta", "--rule", "meta-adam")
    packed = metapp("pack", run, "--out", tmp_path / "a.pack", "--bits", "16", "--json").document
    back = metapp("unpack", tmp_path / "a.pack", "--json")
    assert back.code == 0
    assert back.document["out"] == str(tmp_path / "a")
    for name in packed["tasks"]:
        ours, theirs = read_theta(tmp_path / "a", name), read_theta(run, name)
        for key, value in theirs.items():
            torch.testing.assert_close(ours[key], value, rtol=0, atol=float(value.abs().max()) * 1e-4)
    told = metapp("compare", tmp_path / "a", run, "--json").document
    assert told["compared"]["value"] == pytest.approx(1, abs=1e-3)
    exported = metapp("export", tmp_path / "a", "nbrdf", "--quiet")
    assert exported.code == 0
    assert (tmp_path / "a" / "nbrdf" / "m3" / "b3.npy").is_file()


def test_mitsuba_reads_what_was_unpacked(metapp: Callable, fitted: Callable, tmp_path: Path) -> None:
    pytest.importorskip("mitsuba", reason="needs libatomic1", exc_type=ImportError)
    from metapp.mitsuba import read_material

    for rule in ("ridge", "meta-adam"):
        metapp("pack", fitted("meta", "--rule", rule), "--out", tmp_path / f"{rule}.pack", "--bits", "12", "--quiet")
        assert metapp("unpack", tmp_path / f"{rule}.pack", "--quiet").code == 0
        assert read_material(tmp_path / rule / "params" / "m0.safetensors")


def test_the_shared_network_is_not_in_the_file(metapp: Callable, fitted: Callable, tmp_path: Path) -> None:
    """85,000 weights are those of the checkpoint, bit for bit, and cost next to nothing."""
    run = fitted("meta", "--rule", "ridge")
    metapp("pack", run, "--out", tmp_path / "a.pack", "--bits", "2", "--quiet")
    assert (tmp_path / "a.pack").stat().st_size < 2000
    assert metapp("unpack", tmp_path / "a.pack", "--quiet").code == 0
    ours, theirs = read_theta(tmp_path / "a", "m0"), read_theta(run, "m0")
    assert all(torch.equal(ours[key], theirs[key]) for key in theirs if key not in ("z", "last"))


@pytest.mark.parametrize("paradigm", ["general", "quickft", "overfit"])
def test_fits_of_every_start_are_packed(metapp: Callable, fitted: Callable, paradigm: str, tmp_path: Path) -> None:
    steps = ("--steps", "30") if paradigm == "overfit" else ()
    told = metapp("pack", fitted(paradigm, *steps), "--out", tmp_path / "a.pack", "--json").document
    assert told["after"] <= (1 + GROWTH) * told["before"]
    assert metapp("unpack", tmp_path / "a.pack", "--json").document["after"] == told["after"]


def test_another_checkpoint_is_refused(metapp: Callable, networks: Path, tmp_path: Path) -> None:
    mine = tmp_path / "mine.safetensors"
    start, info = load_checkpoint(shipped_path("brdf", "general"))
    save_checkpoint(mine, start, info | {"note": "mine"})
    words = ("--recipe", "quick", "--checkpoint", mine, "--out", tmp_path / "runs", "--json", "--quiet")
    run = metapp("general", "brdf", networks, *words).document["out"]
    pack = tmp_path / "a.pack"
    assert metapp("pack", run, "--out", pack, "--checkpoint", mine, "--quiet").code == 0
    for words in (("pack", run), ("unpack", pack)):
        refused = metapp(*words)
        assert refused.code == 1
        assert "expected" in refused.err
        assert "by which the fits were made; give that file by --checkpoint." in refused.err
    assert metapp("unpack", pack, "--checkpoint", mine, "--quiet").code == 0


def test_without_references_bits_are_fixed_and_it_is_said(metapp: Callable, fitted: Callable, tmp_path: Path) -> None:
    run = fitted("general")
    records = read_records(run / "record.jsonl")
    for record in records:
        record["origin"]["inputs"] = [str(tmp_path / "gone")]
    (run / "record.jsonl").write_text("".join(json.dumps(record) + "\n" for record in records))
    result = metapp("pack", run, "--json")
    assert result.code == 0
    assert (result.document["bits"], result.document["after"]) == (12, None)
    assert "note: no errors to choose bits by" in result.err
    assert metapp("unpack", run / "fits.pack", "--quiet").code == 0


def test_bad_files_are_one_line(metapp: Callable, tmp_path: Path) -> None:
    (tmp_path / "a.pack").write_bytes(b"hello")
    for words in (("unpack", tmp_path / "a.pack"), ("unpack", tmp_path / "b.pack"), ("pack", tmp_path)):
        result = metapp(*words)
        assert result.code == 1
        (line,) = result.err.splitlines()
        assert line.startswith("error: ")
        assert "expected" in line


def test_tensors_of_no_network_are_refused(metapp: Callable, fitted: Callable, tmp_path: Path) -> None:
    metapp("pack", fitted("meta", "--rule", "meta-adam"), "--out", tmp_path / "a.pack", "--bits", "8", "--quiet")
    whole = read_pack(tmp_path / "a.pack")
    first = next(iter(whole.tensors))
    huge = whole.tensors[first]._replace(step=1e300)
    for tensors in ({}, dict(list(whole.tensors.items())[1:]), {**whole.tensors, first: huge}):
        write_pack(tmp_path / "b.pack", whole._replace(tensors=tensors))
        result = metapp("unpack", tmp_path / "b.pack")
        assert result.code == 1
        assert "is not one of brdf, expected a fit's; pack the fits again." in result.err
        assert not (tmp_path / "b").exists()
