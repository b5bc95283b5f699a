"""`metapp export`: the fits of a run in other forms, which their programs load."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from data_tools.formats import exports_of
from tests.small_spheres import run_small

pytestmark = pytest.mark.usefixtures("small_spheres")
FORMS = "bsdf, bsdf-spectral, cpp, glsl, hlsl, materialx, merl, mitsuba, nbrdf, onnx, osl, slang, wgsl"
FILES = {
    "nbrdf": ["{}/fc1.npy"],
    "merl": ["{}.binary"],
    "bsdf": ["{}.bsdf"],
    "bsdf-spectral": ["{}_spec.bsdf"],
    "mitsuba": ["{}/{}.xml", "{}/{}_builtin.xml", "{}/{}.safetensors", "{}/{}.bsdf"],
    "materialx": ["{0}/{0}.mtlx", "{0}/{0}.glsl", "{0}/{0}.osl"],
    "cpp": ["{0}.h"],
    "onnx": ["{0}.onnx"],
    **{form: [f"{{0}}.{form}"] for form in ("glsl", "hlsl", "osl", "slang", "wgsl")},
}


@pytest.fixture(scope="module")
def finished(neural_fits: Callable[[int], Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of two networks, fitted by Meta's gradient rule; for tests to copy, not to write to."""
    folder = tmp_path_factory.mktemp("finished")
    run_small("meta", "brdf", neural_fits(2), "--rule", "meta-curvature", "--out", folder, "--quiet")
    (record,) = folder.rglob("record.jsonl")
    return record.parent


@pytest.fixture
def run(finished: Path) -> Path:
    return Path(shutil.copytree(finished, Path("runs") / finished.name))


@pytest.mark.long
def test_every_fit_is_written(metapp: Callable, run: Path) -> None:
    for kind in exports_of("brdf"):
        document = metapp("export", run, kind, "--json").done
        assert document == {"form": kind, "out": str(run / kind), "tasks": ["m0", "m1"]}
        made = [file.format(name, name) for name in document["tasks"] for file in FILES[kind]]
        assert all((run / kind / file).is_file() for file in made), kind
        assert metapp("export", run / "record.jsonl", kind, "--out", f"else/{kind}", "--quiet") == (0, "", "")
        assert Path("else", kind, made[0]).read_bytes() == (run / kind / made[0]).read_bytes(), kind


@pytest.mark.long
def test_a_ridge_fit_is_distilled_where_its_input_is_given(
    metapp: Callable, neural_fits: Callable[[int], Path]
) -> None:
    network = neural_fits(1) / "m0"
    run = metapp("meta", "brdf", network, "--json", "--quiet").document["out"]
    Path("moved").mkdir()
    moved = network.rename(Path("moved").absolute() / "m0")
    assert "m0: nbrdf is made of the fit and its input" in metapp("export", run, "nbrdf").error
    done = metapp("export", run, "nbrdf", moved)
    assert done.code == 0
    assert "distilled" in done.err
    assert Path(run, "nbrdf", "m0", "b3.npy").is_file()


def test_what_cannot_be_written_is_refused(metapp: Callable, run: Path) -> None:
    for words, said in (
        ((run, "blend"), f"expects one of {FORMS}"),
        ((run, "gltf"), "expects one of"),
        ((run, "merl", "--size", "64x64"), "--size"),
    ):
        assert said in metapp("export", *words).misuse
    refused = metapp("export", "nowhere", "nbrdf").error
    assert "nowhere: no such folder, expected a run's folder" in refused
    assert "no record.jsonl with fits" in metapp("export", run / "params", "nbrdf").error


def test_of_a_folder_of_runs_the_newest_is_taken(metapp: Callable, run: Path) -> None:
    other = Path("runs/brdf/meta/later")
    shutil.copytree(run, other)
    for times, newest in ((1, run), (3, other)):
        os.utime(run / "record.jsonl", (2, 2))
        os.utime(other / "record.jsonl", (times, times))
        said = metapp("export", "runs", "nbrdf", "--out", "made", "--quiet")
        assert said == (0, "", f"runs: the newest run is {newest}\n")
    assert metapp("export", "runs/brdf", "nbrdf", "--json").document["out"] == str(other / "nbrdf")
    assert "runs/brdf: the newest run" not in metapp("export", other, "nbrdf").err


def test_a_run_behind_a_link_is_not_the_newest(metapp: Callable, run: Path) -> None:
    """A folder that somebody sent must not lead to runs elsewhere, where files would be written."""
    Path("sent").mkdir()
    Path("sent/x").symlink_to(run.resolve())
    Path("sent/y").mkdir()
    Path("sent/y/record.jsonl").symlink_to(run.resolve() / "record.jsonl")
    Path("sent/broken").mkdir()
    Path("sent/broken/record.jsonl").symlink_to("nothing")
    assert "sent: no record.jsonl with fits" in metapp("export", "sent", "nbrdf").error
    assert not (run / "nbrdf").exists()


def test_strange_records_are_one_line(metapp: Callable, run: Path) -> None:
    lines = [json.loads(line) for line in (run / "record.jsonl").read_text().splitlines()]
    lines[0]["settings"]["recipe"] = "other"
    (run / "record.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    assert "a fit of other settings than are known" in metapp("export", run, "merl").error
