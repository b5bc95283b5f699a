"""`metapp pack` and `metapp unpack`: fits as quantised differences from the checkpoint, end to end."""

from __future__ import annotations

import functools
import json
import lzma
import math
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch

from metapp.extensions.packs import pack
from metapp.extensions.packs.file import PackFile, write_pack
from metapp.extensions.packs.pack import GROWTH
from metapp.runs.checkpoints.shipped import shipped_path
from metapp.storage.records import load_checkpoint, read_records, read_theta, save_checkpoint
from tests.marked import long
from tests.small_spheres import run_small

pytestmark = pytest.mark.usefixtures("small_spheres")
NETWORKS = 4


@pytest.fixture(scope="module")
def kept(networks: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Fits the networks once for each paradigm and its options; runs not to write to."""

    @functools.cache
    def fit(paradigm: str, *more: str) -> Path:
        folder = tmp_path_factory.mktemp("fits")
        run_small(paradigm, "brdf", networks, "--recipe", "quick", "--quiet", *more, "--out", folder)
        (record,) = folder.rglob("record.jsonl")
        return record.parent

    return fit


@pytest.fixture
def fitted(kept: Callable[..., Path]) -> Callable[..., Path]:
    """A copy of such a run in the test's folder."""

    def fit(paradigm: str, *more: str) -> Path:
        run = kept(paradigm, *more)
        return Path(shutil.copytree(run, Path("runs", paradigm, run.name)))

    return fit


@pytest.mark.parametrize("rule", ["ridge", long("meta-curvature")])
def test_a_pack_is_small_and_its_error_grows_by_a_hundredth(metapp: Callable, fitted: Callable, rule: str) -> None:
    run = fitted("meta", "--rule", rule)
    result = metapp("pack", run, "--out", "a.pack", "--json")
    told = result.done
    assert told["size"] == Path("a.pack").stat().st_size < 4 * 4 * 675
    assert told["after"] - told["before"] <= GROWTH * told["before"]
    errors = [record["error"] for record in read_records(run / "record.jsonl")]
    assert told["before"] == pytest.approx(sum(errors) / 4, rel=1e-6)
    assert f"{told['size']:,} bytes" in result.err
    fewer = metapp("pack", run, "--out", "b.pack", "--bits", told["bits"] - 1, "--json").document
    assert fewer["after"] - fewer["before"] > GROWTH * fewer["before"]


@pytest.mark.parametrize("state", [long(state) for state in ("there", "moved", "older records", "changed")])
def test_inputs_of_a_run_of_many_are_found(metapp: Callable, networks: Path, state: str) -> None:
    """Its records tell each input from others; where it was moved to is said after RUN."""
    materials = shutil.copytree(networks, Path("materials"))
    words = ("--rule", "ridge", "--batch", "2", "--recipe", "quick", "--json", "--quiet")
    run = Path(metapp("meta", "brdf", materials, *words).done["out"])
    records, given = read_records(run / "record.jsonl"), ()
    if state == "moved":
        given = (materials.rename(Path("moved")),)
    elif state == "older records":
        lines = [json.dumps({key: value for key, value in each.items() if key != "origin"}) for each in records]
        (run / "record.jsonl").write_text("\n".join(lines) + "\n")
    elif state == "changed":
        shutil.rmtree(materials / "m0")
        shutil.copytree(materials / "m1", materials / "m0")
        records = records[1:]
    result = metapp("pack", run, *given, "--json")
    assert result.done["before"] == pytest.approx(sum(each["error"] for each in records) / len(records), rel=1e-6)
    assert result.document["after"] <= (1 + GROWTH) * result.document["before"]
    assert ("note: errors of 3 of 4 fits" in result.err) == (state == "changed")


def test_an_unpacked_run_is_a_run(metapp: Callable, fitted: Callable) -> None:
    run = fitted("meta", "--rule", "meta-curvature")
    packed = metapp("pack", run, "--out", "a.pack", "--bits", "16", "--json").document
    assert metapp("unpack", "a.pack", "--json").done["out"] == "a"
    for name in packed["tasks"]:
        ours, theirs = read_theta(Path("a"), name), read_theta(run, name)
        for key, value in theirs.items():
            torch.testing.assert_close(ours[key], value, rtol=0, atol=float(value.abs().max()) * 1e-4)
    told = metapp("compare", "a", run, "--json").document
    assert told["compared"]["value"] == pytest.approx(1, abs=1e-3)
    assert metapp("export", "a", "nbrdf", "--quiet").code == 0
    assert Path("a/nbrdf/m3/b3.npy").is_file()


def test_a_pack_without_finite_errors_is_refused(
    metapp: Callable, fitted: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As where so few bits make a network overflow."""
    run = fitted("meta", "--rule", "ridge")
    restored = pack.restored
    infinite = lambda steps, base: {key: value + math.inf for key, value in restored(steps, base).items()}  # noqa: E731
    monkeypatch.setattr(pack, "restored", infinite)
    assert "no finite error at 2 bits a number; give more --bits" in metapp("pack", run, "--bits", "2", "-q").error
    assert not list(run.glob("*.pack"))


def test_the_shared_network_is_not_in_the_file(metapp: Callable, fitted: Callable) -> None:
    """85,000 weights are those of the checkpoint, bit for bit, and cost next to nothing."""
    run = fitted("meta", "--rule", "ridge")
    metapp("pack", run, "--out", "a.pack", "--bits", "4", "--quiet")
    assert Path("a.pack").stat().st_size < 2000
    assert metapp("unpack", "a.pack", "--quiet").code == 0
    ours, theirs = read_theta(Path("a"), "m0"), read_theta(run, "m0")
    assert all(torch.equal(ours[key], theirs[key]) for key in theirs if key not in ("z", "last"))


@pytest.mark.long
def test_fits_of_every_paradigm_are_packed(metapp: Callable, fitted: Callable) -> None:
    for paradigm, *steps in (("general",), ("quickft",), ("overfit", "--steps", "30")):
        told = metapp("pack", fitted(paradigm, *steps), "--out", f"{paradigm}.pack", "--json").document
        assert told["after"] <= (1 + GROWTH) * told["before"], paradigm
        assert metapp("unpack", f"{paradigm}.pack", "--json").document["after"] == told["after"], paradigm


def test_another_checkpoint_is_refused(metapp: Callable, networks: Path) -> None:
    checkpoint, info = load_checkpoint(shipped_path("brdf", "general"))
    save_checkpoint(Path("mine.safetensors"), checkpoint, info | {"note": "mine"})
    mine = ("--checkpoint", "mine.safetensors")
    run = Path(metapp("general", "brdf", networks, "--recipe", "quick", "--json", "--quiet", *mine).done["out"])
    assert metapp("pack", run, "--out", "a.pack", *mine, "--quiet").code == 0
    for words in (("pack", run), ("unpack", "a.pack")):
        refused = metapp(*words).error
        assert "expected" in refused
        assert "by which the fits were made; give that file by --checkpoint." in refused
    assert metapp("unpack", "a.pack", *mine, "--quiet").code == 0


def test_without_references_bits_are_fixed_and_it_is_said(metapp: Callable, fitted: Callable) -> None:
    run = fitted("general")
    records = read_records(run / "record.jsonl")
    for record in records:
        record["origin"]["inputs"] = ["gone"]
        record["source"] = "gone"
    (run / "record.jsonl").write_text("".join(json.dumps(record) + "\n" for record in records))
    result = metapp("pack", run, "--json")
    assert (result.done["bits"], result.document["after"]) == (12, None)
    assert "note: no errors to choose bits by" in result.err
    assert metapp("unpack", run / "fits.pack", "--quiet").code == 0


def test_bad_files_are_one_line(metapp: Callable, fitted: Callable) -> None:
    Path("a.pack").write_bytes(b"hello")
    for words in (("unpack", "a.pack"), ("unpack", "b.pack"), ("pack", ".")):
        assert "expected" in metapp(*words).refusal
    run = fitted("meta", "--rule", "meta-curvature")
    metapp("pack", run, "--out", "a.pack", "--bits", "8", "--quiet", "--overwrite")
    whole = PackFile(Path("a.pack")).read()
    first = next(iter(whole.tensors))
    huge = whole.tensors[first]._replace(step=1e300)
    for tensors in ({}, dict(list(whole.tensors.items())[1:]), {**whole.tensors, first: huge}):  # of no network
        write_pack(Path("b.pack"), whole._replace(tensors=tensors))
        assert "is not one of brdf, expected a fit's; pack the fits again." in metapp("unpack", "b.pack").error
        assert not Path("b").exists()


BOMBS = ("shape", "name", "tasks")


@pytest.mark.long
def test_what_a_pack_declares_is_compared_before_it_is_unfolded(metapp: Callable, fitted: Callable) -> None:
    """40 kB that unfold to 256 MB: unpacking takes no more memory than refusing what is no pack."""
    metapp("pack", fitted("general"), "--out", "a.pack", "--bits", "8", "--quiet")
    content = lzma.decompress(Path("a.pack").read_bytes())
    length = int.from_bytes(content[:4], "little")
    for bomb in BOMBS:
        _write_bomb(bomb, json.loads(content[4 : 4 + length]))
    words = [sys.executable, "-c", UNPACKED, *BOMBS]
    done = subprocess.run(words, check=True, capture_output=True, text=True)
    refusals, (before, *after) = done.stdout.splitlines()[:3], map(int, done.stdout.splitlines()[3:])
    for bomb, refusal, peak in zip(BOMBS, refusals, after, strict=True):
        assert refusal.startswith(f"{bomb}.pack: ")
        assert "expected" in refusal
        assert peak - before < 100_000, bomb  # kB
        assert not Path(bomb).exists()


def _write_bomb(bomb: str, head: dict[str, Any]) -> None:
    """A pack by this header, of which a part is too large, and as many zeros as it tells."""
    size, first = 1 << 28, head["tensors"][0]
    if bomb == "tasks":
        head["tasks"] += [f"t{i}" for i in range(size // _fit_bytes(head))]
    elif bomb == "shape":
        first["shape"] = [size // NETWORKS]
    else:
        head["tensors"].append({**first, "name": "more", "shape": [size // NETWORKS]})
    text, zeros = json.dumps(head).encode(), bytes(len(head["tasks"]) * _fit_bytes(head))
    content = len(text).to_bytes(4, "little") + text + zeros
    Path(f"{bomb}.pack").write_bytes(lzma.compress(content, check=lzma.CHECK_NONE, preset=0))


def _fit_bytes(head: dict[str, Any]) -> int:
    """What one fit's planes take by a header."""
    return sum(math.prod(tensor["shape"]) * tensor["planes"] for tensor in head["tensors"])


UNPACKED = """
import sys
from pathlib import Path
from metapp import door
from metapp.extensions.packs.pack import unpack

def peak():
    return Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0]

unpack(Path("a.pack"), None, None)
peaks = [peak()]
for bomb in sys.argv[1:]:
    try:
        unpack(Path(f"{bomb}.pack"), None, None)
    except ValueError as error:
        print(error)
        peaks.append(peak())
print(*peaks, sep="\\n")
"""
