"""`metapp export`: the fits of a run in other forms, which their programs load."""

import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from metapp.runs.stored_fits import read_fits
from metapp.storage.fit_folders import PARAMS, RECORD
from tests.cli.messages import says
from tests.recipe_apps import exports_of
from tests.small_spheres import run_with_small_spheres

pytestmark = pytest.mark.usefixtures("small_spheres")
FORMS = "bsdf, bsdf-spectral, cpp, glsl, hlsl, materialx, merl, mitsuba, nbrdf, osl, wgsl"
FILES = {
    "nbrdf": ["{}/fc1.npy"],
    "merl": ["{}.binary"],
    "bsdf": ["{}.bsdf"],
    "bsdf-spectral": ["{}_spec.bsdf"],
    "mitsuba": ["{}/{}.xml", "{}/{}_builtin.xml", "{}/{}.safetensors", "{}/{}.bsdf"],
    "materialx": ["{0}/{0}.mtlx", "{0}/{0}.glsl", "{0}/{0}.osl"],
    "cpp": ["{0}.h"],
    **{form: [f"{{0}}.{form}"] for form in ("glsl", "hlsl", "osl", "wgsl")},
}


@pytest.fixture(scope="module")
def finished_run(write_nbrdf_networks: Callable[[int], Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of two networks, fitted by Meta's gradient rule; for tests to copy, not to write to."""
    folder = tmp_path_factory.mktemp("finished")
    run_with_small_spheres(
        "meta", "brdf", write_nbrdf_networks(2), "--rule", "meta-curvature", "--out", folder, "--quiet"
    )
    first, _ = folder.rglob(RECORD)
    return first.parents[1]


@pytest.fixture
def run(finished_run: Path) -> Path:
    return Path(shutil.copytree(finished_run, Path("runs/brdf") / finished_run.name))


@pytest.mark.long
def test_every_fit_is_written(metapp: Callable, run: Path) -> None:
    for kind in exports_of("brdf"):
        document = metapp("export", run, kind, "--json").json_result
        assert document == {"form": kind, "out": str(run), "tasks": ["m0", "m1"]}
        for name in document["tasks"]:
            result = [file.format(name, name) for file in FILES[kind]]
            assert all((run / name / kind / file).is_file() for file in result), kind
        assert metapp("export", run / "m1", kind, "--out", f"else/{kind}", "--quiet") == (0, "", "")
        assert Path("else", kind, result[0]).read_bytes() == (run / "m1" / kind / result[0]).read_bytes(), kind
    one = metapp("export", run / "m1", "nbrdf", "--json").json_document
    assert one == {"form": "nbrdf", "out": str(run / "m1" / "nbrdf"), "tasks": ["m1"]}
    assert metapp("export", run, "nbrdf", "--out", "both", "--quiet") == (0, "", "")
    assert {path.name for path in Path("both").iterdir()} == {"m0", "m1"}


@pytest.mark.long
def test_a_ridge_fit_is_distilled_once_where_its_input_is_given(
    metapp: Callable, write_nbrdf_networks: Callable[[int], Path]
) -> None:
    network = write_nbrdf_networks(1) / "m0"
    fitted = metapp("meta", "brdf", network, "--export", "cpp,glsl,wgsl", "--json", "--quiet")
    assert fitted.err.count("m0: distilled") == 1
    run = fitted.json_document["out"]
    assert len([*Path(run, "m0").glob("*/m0.*")]) == 3
    Path("moved").mkdir()
    moved = network.rename(Path("moved").absolute() / "m0")
    assert says(metapp("export", run, "nbrdf").error, "m0: nbrdf", "input")
    result = metapp("export", run, "nbrdf", moved)
    assert result.code == 0
    assert "distilled" in result.err
    assert Path(run, "m0", "nbrdf", "m0", "b3.npy").is_file()


def test_exports_that_a_fit_lacks_are_refused(metapp: Callable, run: Path) -> None:
    for words, facts in (((run, "blend"), ("blend", FORMS)), ((run, "merl", "--size", "64x64"), ("--size", "brdf"))):
        assert says(metapp("export", *words).misuse, *facts)


def test_newest_run_of_a_folder_is_exported(metapp: Callable, run: Path) -> None:
    other = Path("runs/brdf/later")
    shutil.copytree(run, other)
    for times, newest in ((1, run), (3, other)):
        for place, when in ((run, 2), (other, times)):
            for name in ("m0", "m1"):
                os.utime(place / name / RECORD, (when, when))
        output = metapp("export", "runs", "nbrdf", "--out", "made", "--quiet")
        assert (output.code, output.out) == (0, "")
        assert says(output.err, "runs: ", str(newest))
    assert metapp("export", "runs/brdf", "nbrdf", "--json").json_document["out"] == str(other)
    assert not says(metapp("export", other, "nbrdf").err, "newest")


def test_a_run_behind_a_link_is_not_the_newest(metapp: Callable, run: Path) -> None:
    """A folder that somebody sent must not lead to runs elsewhere, where files would be written."""
    Path("sent").mkdir()
    Path("sent/x").symlink_to(run.resolve())
    for name, target in (("y", run.resolve() / "m0" / RECORD), ("broken", "nothing")):
        Path("sent", name, "m0").mkdir(parents=True)
        Path("sent", name, "m0", RECORD).symlink_to(target)
    assert says(metapp("export", "sent", "nbrdf").error, "sent: ", "expected")
    assert not list(run.rglob("nbrdf"))


def test_damaged_parameters_and_strange_records_are_one_line(metapp: Callable, run: Path) -> None:
    (run / "m0" / PARAMS).write_bytes(b"hello")
    assert "m0/params.safetensors: " in metapp("export", run, "merl").error
    fit = read_fits(run)[0]
    fit.spec = replace(fit.spec, recipe="other")
    (run / "m0" / RECORD).write_bytes(fit.record())
    passed_over = metapp("export", run, "merl")
    assert passed_over.code == 0
    assert says(passed_over.err, f"m0/{RECORD}", "settings", "'other'", "passed over")
