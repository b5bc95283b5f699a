"""The Python API gives what the command line gives."""

from __future__ import annotations

import base64
import io
import pickle
import re
import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

import metapp as api
from metapp.appearance.geometry import rusinkiewicz_to_directions
from metapp.rendering.variant import load_mitsuba
from metapp.runs.outputs.pictures import to_srgb
from metapp.storage.files import read_tensors
from tests import pictures
from tests.needs_mitsuba import needs_mitsuba
from tests.scene_files import OBJ


@pytest.fixture
def network(neural_fits: Callable[[int], Path]) -> Path:
    """A folder with one small network."""
    return next(iter(sorted(neural_fits(1).iterdir())))


def test_a_fit_is_that_of_the_command(metapp: Callable, network: Path, tmp_path: Path) -> None:
    told = metapp("meta", "brdf", network, "--out", tmp_path, "--json", "--quiet").document
    fit = api.fit("brdf", network)
    assert (fit.name, fit.error) == (told["tasks"][0]["name"], told["error"])
    (folder,) = (task["folder"] for task in told["tasks"])
    kept = api.load(folder).parameters
    assert api.load(folder).settings["checkpoint"] == fit.settings["checkpoint"]
    assert (api.load(folder).errors, api.load(folder).task.data.keys()) == (fit.errors, fit.task.data.keys())
    with pytest.raises(ValueError, match="no such folder, expected a run's folder"):
        api.load(tmp_path / "none")
    assert kept.keys() == fit.parameters.keys()
    assert all(torch.equal(kept[key], value) for key, value in fit.parameters.items())
    assert fit.seconds > 0
    assert fit.errors["error"] == fit.error
    assert set(fit.pictures()) == {"reference", "fit"}


def test_a_fit_is_saved_and_exported(network: Path, tmp_path: Path) -> None:
    fit = api.fit("brdf", network, paradigm="general")
    saved = read_tensors(fit.save(tmp_path / "below" / "a.safetensors"))
    assert all(torch.equal(saved[key], value) for key, value in fit.parameters.items())
    fit.export("nbrdf", tmp_path / "again")
    again = api.fit("brdf", tmp_path / "again", paradigm="general")
    assert again.name == "again"
    for form in ("bsdf", "osl"):
        for name in (f"gold.{form}", "gold.1"):  # the suffix may be given; what follows another dot is none
            fit.export(form, tmp_path / form / name)
        assert {path.name for path in (tmp_path / form).iterdir()} == {f"gold.{form}", f"gold.1.{form}"}
    forms = "bsdf, bsdf-spectral, cpp, glsl, hlsl, materialx, merl, mitsuba, nbrdf, onnx, osl, slang, wgsl"
    with pytest.raises(ValueError, match=f"--export 'blend': brdf expects one of {forms}"):
        fit.export("blend", tmp_path / "x")


def test_options_are_those_of_the_command(network: Path) -> None:
    one, two = (api.fit("brdf", network, steps=steps, rule="meta-curvature") for steps in (1, 2))
    assert one.error != two.error
    with pytest.raises(ValueError, match="'brdfs' is not an application; expected one of brdf"):
        api.fit("brdfs", network)
    with pytest.raises(ValueError, match="paradigm 'magic': expected one of general"):
        api.fit("brdf", network, paradigm="magic")
    with pytest.raises(ValueError, match=r"^--rule: rule 'magic': 'magic' is unknown"):
        api.fit("brdf", network, rule="magic")
    for name, value in {"train": True, "train_steps": 2, "resume": True, "export": "merl"}.items():
        with pytest.raises(ValueError, match=f"^{name}: of the command line"):
            api.fit("brdf", network, **{name: value})


@pytest.mark.filterwarnings("ignore:.* times the light that comes in")  # random networks
def test_several_tasks_are_a_list(neural_fits: Callable[[int], Path]) -> None:
    folder = neural_fits(2)
    fits = api.fit_all("brdf", [folder])
    assert len(fits) == 2
    assert all(f"{fit.name}: error {fit.error:.3f}" in repr(fits) for fit in fits)
    with pytest.raises(ValueError, match=r"2 tasks, expected one; take metapp\.fit_all"):
        api.fit("brdf", folder)


def test_an_address_is_no_path_that_is_there() -> None:
    with pytest.raises(
        ValueError, match=r"^s3:/bucket/gold\.binary: no such file or folder; give existing input files\.$"
    ):
        api.fit("brdf", "s3://bucket/gold.binary")


def test_the_traceback_of_bad_input_ends_at_the_call(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for app, source, said in (("brdf", tmp_path / "none", "none: no such file or folder"), ("brfd", tmp_path, "brdf")):
        with pytest.raises(ValueError, match=said) as short:
            api.fit(app, source)
        with monkeypatch.context() as patch:
            patch.setenv("METAPP_TRACEBACK", "1")
            with pytest.raises(ValueError, match=said) as whole:
                api.fit(app, source)
        assert [entry.name for entry in short.traceback[1:]] == ["fit"]
        assert len(whole.traceback) > 4
        assert short.value.__context__ is None


def test_nothing_is_printed_and_threads_stay(network: Path, capfd: pytest.CaptureFixture[str]) -> None:
    before = torch.get_num_threads()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        api.fit("brdf", network)
    assert capfd.readouterr() == ("", "")
    assert torch.get_num_threads() == before


def test_the_package_imports_at_once() -> None:
    lines = "import sys, metapp\nprint({'torch', 'numpy', 'typer', 'rich'} & sys.modules.keys(), metapp.__version__)"
    done = subprocess.run([sys.executable, "-c", lines], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("set()")
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = api.nothing


def lambertian(wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
    return np.full((len(wi), 3), (0.2, 0.4, 0.6)) / np.pi


def directions(count: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    wi, wo = rng.normal(size=(2, count, 3))
    return tuple(np.abs(each) / np.linalg.norm(each, axis=1, keepdims=True) for each in (wi, wo))


def test_a_function_is_fitted() -> None:
    fit = api.fit("brdf", lambertian)
    assert fit.name == "lambertian"
    assert fit.error < 0.5
    angles = torch.tensor([[0.3, 0.4, 1.0]])
    torch.testing.assert_close(
        fit.app.reflectance(fit.parameters, angles)[0], torch.tensor([0.2, 0.4, 0.6]) / np.pi, rtol=0.1, atol=0.01
    )
    with warnings.catch_warnings():  # of a function whose array is read-only
        warnings.simplefilter("error")
        constant = api.fit("brdf", lambda wi, wo: np.broadcast_to(np.float32([0.3, 0.2, 0.1]), wi.shape)[:, ::-1])
    assert constant.task.data["reflectance"][0].tolist() == pytest.approx([0.1, 0.2, 0.3])
    gray = api.fit("brdf", lambda wi, wo: torch.full((len(wi),), 0.1), paradigm="general")
    assert torch.equal(gray.task.data["reflectance"][:, 0], gray.task.data["reflectance"][:, 2])


def test_a_bsdf_of_mitsuba_is_fitted() -> None:
    mi = load_mitsuba()
    bsdf = mi.load_dict({"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.2, 0.4, 0.6]}})
    fit = api.fit("brdf", bsdf, paradigm="general")
    known = torch.tensor([0.2, 0.4, 0.6]) / np.pi
    torch.testing.assert_close(fit.task.data["reflectance"], known.expand(len(fit.task.data["angles"]), 3))


@pytest.mark.parametrize(
    ("source", "line"),
    [
        (3, "object: int, expected a path, a function"),
        ((1, 2), "2 arrays, expected 3"),
        ((np.zeros((0, 3)),) * 3, "object: different pairs of directions: 0 of 0, expected 4 or more"),
        ((np.zeros((9, 3)), np.ones((9, 3)), np.ones((9, 3))), "wi of length 0, expected unit vectors"),
        ((*directions(3), np.ones((3, 3))), "different pairs of directions: 3 of 3, expected 4"),
        ((*directions(80), -np.ones((80, 3))), "reflectance that is negative"),
        (lambda wi, wo: wi[:, :2], r"values \(\d+, 2\), expected"),
        (lambda wi, wo: -np.abs(wi), "reflectance of -1 /sr, expected 0 or more"),
    ],
)
def test_what_is_no_brdf_in_memory_is_refused_in_a_line(source: object, line: str) -> None:
    with pytest.raises(ValueError, match=line):
        api.fit("brdf", source)


def test_a_fit_evaluates_its_application_and_nothing_below_the_surface(network: Path) -> None:
    fit = api.fit("brdf", network, paradigm="general")
    angles = torch.tensor([[0.3, 0.4, 1.0], [0.1, 0.9, 4.0]])
    pair = rusinkiewicz_to_directions(angles.double())
    values = fit(*pair)
    torch.testing.assert_close(values, fit.app.reflectance(fit.parameters, angles), rtol=1e-4, atol=1e-6)
    again = fit(*(each.numpy() for each in pair))
    assert again.dtype == np.float32
    np.testing.assert_array_equal(again, values.numpy())
    up, down = np.array([[0.0, 0.0, 1.0]]), np.array([[0.0, 0.0, -1.0]])
    assert not fit(up, down).any()
    assert not fit(down, up).any()
    assert fit(up[:0], up[:0]).shape == (0, 3)


def test_an_anisotropic_fit_knows_the_azimuth() -> None:
    def brushed(wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        half = (wi + wo) / np.linalg.norm(wi + wo, axis=1, keepdims=True)
        return np.repeat(0.2 + 0.5 * half[:, :1] ** 2, 3, 1)

    fit = api.fit("brdf", brushed)
    wi, wo = directions(200)
    assert np.abs(fit(wi, wo) - brushed(wi, wo)).mean() < 0.02
    turned = [each[:, [1, 0, 2]] for each in (wi, wo)]
    assert np.abs(fit(*turned) - brushed(wi, wo)).mean() > 0.05


@pytest.mark.parametrize(
    ("wi", "wo", "line"),
    [
        (np.ones((2, 3)), np.ones((2, 3)), "m0: wi of length 1.732, expected unit vectors"),
        ([[0, 0, 1]], np.zeros((1, 3)), "m0: wo of length 0, expected unit vectors"),
        (np.ones(3), np.ones(3), r"m0: wi \(3,\), expected \[N, 3\]"),
        ([[0, 0, 1]], [[0, 0, 1]] * 2, "m0: 1 wi and 2 wo, expected as many of both"),
        ("up", "up", "m0: wi: str, expected an array of numbers"),
    ],
)
def test_a_fit_refuses_what_are_no_directions(network: Path, wi: object, wo: object, line: str) -> None:
    fit = api.fit("brdf", network, paradigm="general")
    with pytest.raises(ValueError, match=line):
        fit(wi, wo)


def by_general(app: str, source: object, **options: str) -> api.Fit:
    return api.fit(app, source, paradigm="general", recipe="quick", **options)


def assert_same(fit: api.Fit, other: api.Fit) -> None:
    """Two fits saw the same and came to the same, bit by bit."""
    assert (fit.name, fit.error) == (other.name, other.error)
    assert fit.settings | {"data": ""} == other.settings | {"data": ""}  # of files by their paths
    for made, known in ((fit.task.data, other.task.data), (fit.parameters, other.parameters)):
        assert made.keys() == known.keys()
        assert all(torch.equal(value, known[key]) for key, value in made.items())


@pytest.mark.usefixtures("vgg")
def test_a_flash_photo_in_memory_is_that_of_its_file(tmp_path: Path) -> None:
    pixels = pictures.noise(64, 64)
    fit = by_general("svbrdf_stationary", pixels)
    assert_same(fit, by_general("svbrdf_stationary", pictures.write(tmp_path / "object.png", pixels)))
    assert {name: values.ndim for name, values in fit.maps.items()} == {
        "diffuse": 3,
        "specular": 3,
        "normal": 3,
        "roughness": 2,
        "height": 2,
    }
    np.testing.assert_allclose(np.linalg.norm(fit.maps["normal"], axis=-1), 1, atol=1e-5)


def test_a_material_in_memory_is_that_of_its_files(tmp_path: Path) -> None:
    maps = {name: pictures.noise(64, 64, seed=seed) for seed, name in enumerate(("diffuse", "specular", "roughness"))}
    maps["normal"] = np.full_like(maps["diffuse"], (128, 128, 255))
    for name, values in maps.items():
        pictures.write(tmp_path / "files" / f"object_{name}.png", values)
    fit = by_general("svbrdf_nonstationary", maps)
    assert_same(fit, by_general("svbrdf_nonstationary", tmp_path / "files"))
    again = by_general("svbrdf_nonstationary", fit.maps)  # what a fit gives is what another takes
    for part, name in (slice(3), "normal"), (slice(3, 6), "diffuse"), (slice(6, 7), "roughness"):
        given = torch.from_numpy(np.atleast_3d(fit.maps[name])).permute(2, 0, 1)
        assert (again.task.data["maps"][part].float() - given).abs().max() < 2e-3, name


def test_a_photo_in_memory_is_fitted_alone(tmp_path: Path) -> None:
    pixels = pictures.noise(64, 64)
    file = pictures.write(tmp_path / "object.png", pixels)
    fit = by_general("svbrdf_nonstationary", pixels, observe="photo")
    assert_same(fit, by_general("svbrdf_nonstationary", file, observe="photo"))
    darker = by_general("svbrdf_nonstationary", pixels, observe="photo", stops=1.0)
    assert_same(darker, by_general("svbrdf_nonstationary", file, observe="photo", stops=1.0))
    assert darker.task.data["photo"].float().mean() < 0.8 * fit.task.data["photo"].float().mean()
    with pytest.raises(ValueError, match=r"object: a flash photo, expected a material's maps .* --observe photo\."):
        by_general("svbrdf_nonstationary", pixels)
    assert (fit.error, fit.picture().width) == (None, fit.picture().height * 2)  # a sheet without a reference


BALL = """<scene version="3.0.0">
  <sensor type="perspective"><float name="fov" value="40"/>
    <transform name="to_world"><lookat origin="0,0,5" target="0,0,0" up="0,1,0"/></transform></sensor>
  <shape type="rectangle"><transform name="to_world"><scale value="4"/></transform></shape>
  <shape type="sphere"/><shape type="{kind}"><string name="filename" value="{file}"/></shape>
  <emitter type="constant"/></scene>"""


@pytest.mark.long
@needs_mitsuba
def test_a_scene_in_memory_is_that_of_its_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Files that it names lie in the current folder, or where `scene_root` says."""
    text = BALL.format(kind="obj", file="corner.obj")
    (tmp_path / "here").mkdir()
    for file in (tmp_path / "here" / "corner.obj", tmp_path / "corner.obj"):
        file.write_text(OBJ)
    (tmp_path / "here" / "object.xml").write_text(text)
    fit = by_general("transport", tmp_path / "here" / "object.xml")
    monkeypatch.chdir(tmp_path / "here")
    again = by_general("transport", text)
    assert_same(again, fit)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    with pytest.raises(ValueError, match=r"object: names the file 'corner.obj': file not found"):
        by_general("transport", text)
    assert by_general("transport", text, scene_root=str(tmp_path)).error == pytest.approx(fit.error, abs=1e-6)


def test_of_what_is_in_memory_errors_name_no_file() -> None:
    for app, source, line in (
        ("texture", np.zeros((40, 40, 3), np.uint8), "^object: one colour all over"),
        ("texture", pictures.noise(20, 20), "^object: 20x20 px, expected 32 px or more"),
        ("svbrdf_stationary", dict.fromkeys(("albedo", "normal"), pictures.noise(40, 40)), "^object: no roughness"),
        ("transport", "<scene", "^object: not readable as XML"),
    ):
        with pytest.raises(ValueError, match=line):
            by_general(app, source)


def test_sources_are_all_paths_or_none() -> None:
    with pytest.raises(ValueError, match="1 of 2 sources are no paths"):
        api.fit_all("brdf", ["a", lambertian])
    for source in ("a.png", Path("a.png"), lambertian, {"diffuse": 1}, 3):
        with pytest.raises(ValueError, match=r"^\w+: one source, expected a list of them; take metapp\.fit for one"):
            api.fit_all("texture", source)
    for array in (np.ones((3, 2)), torch.ones(3, 2)):
        with pytest.raises(ValueError, match=r"^\w+: one source, expected a list of them"):
            api.fit_all("brdf", array)
    with pytest.raises(ValueError, match=r"object-1: ndarray, expected a path, a function"):
        api.fit_all("brdf", list(np.ones((3, 2))))
    with pytest.raises(ValueError, match="0 sources, expected a list of one or more"):
        api.fit_all("brdf", [])


def test_a_fit_can_be_pickled(network: Path) -> None:
    """As programs that fit in several processes send it back."""
    fit = api.fit("brdf", network, recipe="quick")
    again = pickle.loads(pickle.dumps(fit))
    assert (again.name, again.error, again.seconds, again.settings) == (fit.name, fit.error, fit.seconds, fit.settings)
    assert all(torch.equal(value, fit.parameters[key]) for key, value in again.parameters.items())
    assert again.picture().tobytes() == fit.picture().tobytes()


@pytest.mark.parametrize(
    ("options", "line"),
    [
        ({"steps": -1}, "--steps -1: expected 0 to 1,000,000,000"),
        ({"steps": 10**23}, "--steps 100000000000000000000000: expected 0 to 1,000,000,000"),
        ({"seed": 2**63}, "--seed 9223372036854775808: expected 0 to 9,223,372,036,854,775,807"),
        ({"steps": "ten"}, "--steps 'ten': expected int or None"),
        ({"steps": True}, "--steps True: expected int or None"),
        ({"seed": "a"}, "--seed 'a': expected int"),
        ({"conserve": "wide"}, "--conserve 'wide': expected bool"),
        ({"paradigm": 3}, "paradigm: 3, expected str"),
        ({"data": 3}, "--data 3: expected Path or None"),
        ({"step": 3}, "step: no option of a fit, expected one of batch, .* Did you mean 'steps'?"),
    ],
)
def test_options_of_other_types_are_refused_in_a_line(options: dict[str, Any], line: str) -> None:
    with pytest.raises(ValueError, match=line):
        api.fit("brdf", lambertian, **options)


@pytest.mark.parametrize(
    ("app", "options", "line"),
    [
        ("brdf", {"recipe": "slow"}, "--recipe 'slow': expected one of"),
        ("svbrdf_nonstationary", {"observe": "fotto"}, "--observe 'fotto': svbrdf_nonstationary expects one of"),
        (
            "texture",
            {"size": "1000000x1000000"},
            "--size 1000000x1000000: texture expects multiples of 32 from 64 to",
        ),
        ("brdf", {"paradigm": "overfit", "detail": 512}, "--detail: brdf has no such option"),
        ("brdf", {"recipe": "paper", "rule": "meta-encoder"}, "train one with --train"),
    ],
)
def test_errors_name_options_as_the_command_has_them(
    app: str, options: dict[str, Any], line: str, network: Path
) -> None:
    with pytest.raises(ValueError, match=line):
        api.fit(app, network, **options)


def test_errors_leave_names_of_files_as_they_are() -> None:
    with pytest.raises(ValueError, match=r"^paint--old\.binary: no such file or folder"):
        api.fit("brdf", "paint--old.binary")


def test_whole_numbers_are_numbers(network: Path) -> None:
    assert api.fit("brdf", network, paradigm="overfit", steps=1, seed=3).steps == 1
    with pytest.raises(ValueError, match=r"^--fov: brdf has no such option"):
        api.fit("brdf", network, fov=30)


def test_things_in_memory_are_numbered_where_they_have_no_name(network: Path) -> None:
    wi, wo = directions(80)
    samples = wi, wo, lambertian(wi, wo)
    fits = api.fit_all("brdf", [samples, lambertian, samples], paradigm="general")
    assert [fit.name for fit in fits] == ["object-1", "lambertian", "object-2"]


def pictures_in(html: str) -> list[Image.Image]:
    urls = re.findall(r'src="data:image/png;base64,([^"]+)"', html)
    return [Image.open(io.BytesIO(base64.b64decode(url))) for url in urls]


@pytest.mark.usefixtures("compiled")
def test_a_fit_shows_itself(network: Path) -> None:
    fit = api.fit("brdf", network)
    html = fit._repr_html_()
    assert [picture.size for picture in pictures_in(html)] == [(196, 96)]
    assert len(html) < 100_000
    for part in (fit.name, "BRDF, meta", f"error x100 {fit.error:.3f}", f"{fit.seconds:.3g} s", "10 steps"):
        assert part in html
    assert "warning" not in html
    picture = fit.picture()
    assert (picture.mode, picture.size) == ("RGB", (196, 96))
    reference = to_srgb(fit.pictures()["reference"])
    assert np.abs(np.asarray(picture)[:, :96] - 255 * reference).max() <= 0.5 + 1e-4


def test_a_warning_is_shown_and_names_are_text(network: Path) -> None:
    fit = api.fit("brdf", network, paradigm="general")
    fit.task, fit.record["warning"] = fit.task._replace(name="<b>"), "1 < 2"
    html = fit._repr_html_()
    assert "&lt;b&gt;" in html
    assert "warning: 1 &lt; 2" in html


def test_other_fits_have_no_reflectance() -> None:
    fit = by_general("svbrdf_nonstationary", pictures.noise(64, 64), observe="photo")
    with pytest.raises(ValueError, match="object: a fit of svbrdf_nonstationary, expected one of brdf"):
        fit(*directions(2))
