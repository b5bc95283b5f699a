"""The Python API gives what the command line gives."""

import base64
import io
import json
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
from msgspec.structs import replace
from PIL import Image
from safetensors.torch import save_file
from torch import Generator

import metapp as api
from metapp.appearance.colour import composite_to_srgb
from metapp.appearance.geometry import rusinkiewicz_to_directions
from metapp.apps.illumination.suns import SUN_SPECS
from metapp.rendering.variant import load_mitsuba
from metapp.storage.files import read_tensors
from metapp.storage.fit_folders import RECORD, pack_fit
from metapp.storage.parameters import check_params
from tests import pictures
from tests.cli.messages import says
from tests.kept_fits import write_fit
from tests.needs_mitsuba import needs_mitsuba
from tests.recipe_apps import app_by_recipe
from tests.scene_files import OBJ


@pytest.fixture(scope="module")
def general(network: Path) -> api.Fit:
    """General's parameters for a network, which cost nothing; not to be changed."""
    return api.fit("brdf", network, paradigm="general")


def lambertian(wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
    return np.full((len(wi), 3), (0.2, 0.4, 0.6)) / np.pi


def directions(count: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    wi, wo = rng.normal(size=(2, count, 3))
    return tuple(np.abs(vectors) / np.linalg.norm(vectors, axis=1, keepdims=True) for vectors in (wi, wo))


def fit_by_general(app: str, source: object, **options: str) -> api.Fit:
    return api.fit(app, source, paradigm="general", recipe="quick", **options)


def test_fits_in_python_equal_fits_by_the_command(metapp: Callable, network: Path, tmp_path: Path) -> None:
    result = metapp("meta", "brdf", network, "--out", tmp_path, "--json", "--quiet").json_document
    (folder,) = (task["folder"] for task in result["tasks"])
    fit, loaded = api.fit("brdf", network), api.load(folder)
    assert (fit.name, fit.error) == (result["tasks"][0]["name"], result["error"])
    assert loaded.settings["digest"] == fit.settings["digest"]
    assert (loaded.errors, loaded.task.data.keys()) == (fit.errors, fit.task.data.keys())
    assert loaded.parameters.keys() == fit.parameters.keys()
    assert all(torch.equal(loaded.parameters[key], value) for key, value in fit.parameters.items())
    assert fit.seconds > 0
    assert fit.errors["error"] == fit.error
    with pytest.raises(ValueError, match="no such folder, expected a run's folder"):
        api.load(tmp_path / "none")


def test_a_saved_fit_is_loaded_again(network: Path, tmp_path: Path, general: api.Fit) -> None:
    """It has its figures, and its task if the input is in place.

    It is loaded from a file or from files of a fit's folder.
    """
    in_memory = fit_by_general("brdf", lambertian)
    for fit, keys in ((general, general.task.data.keys()), (in_memory, set())):
        again = api.load(fit.save(tmp_path / "a.safetensors", overwrite=True))
        assert (again.name, again.errors, again.seconds, again.settings) == (
            *(fit.name, fit.errors, fit.seconds),
            fit.settings,
        )
        assert all(torch.equal(again.parameters[key], value) for key, value in fit.parameters.items())
        assert again.task.data.keys() == keys
        assert api.load(again.save(tmp_path / "b.safetensors", overwrite=True)).errors == fit.errors
    for name, content in (("tensors", {"w1": torch.zeros(2)}), ("empty", {})):
        save_file(content, tmp_path / name)
    (tmp_path / "text").write_text("a text")
    for name in ("tensors", "empty", "text"):
        with pytest.raises(ValueError, match=rf"{name}: no fit, expected a file of Fit\.save or a folder of a fit"):
            api.load(tmp_path / name)


def damaged(theta: dict[str, torch.Tensor], how: str) -> dict[str, torch.Tensor]:
    key = next(iter(theta))
    value = theta[key]
    others = {
        "nan": {key: value * torch.nan},
        "infinite": {key: value / 0},
        "shape": {key: value[..., :1]},
        "integers": {key: value.long()},
        "missing": {},
    }
    kept = {name: value for name, value in theta.items() if name != key or how not in others}
    return {**kept, **others[how]}


@pytest.mark.parametrize(
    ("how", "problem"),
    [
        ("nan", "hold NaN or infinite values, expected finite numbers"),
        ("infinite", "hold NaN or infinite values, expected finite numbers"),
        ("shape", r"of shape \(.*\), expected \(.*\) of the network of its settings"),
        ("integers", "hold int64, expected finite numbers"),
        ("missing", r"without '\w+', expected those of the network of its settings"),
    ],
)
def test_parameters_of_another_network_are_refused(
    metapp: Callable, general: api.Fit, tmp_path: Path, how: str, problem: str
) -> None:
    """Python and all commands that read fits refuse them."""
    theta = damaged(general.parameters, how)
    (tmp_path / "a.safetensors").write_bytes(pack_fit(general.record(), theta))
    folder = tmp_path / "run" / "a"
    write_fit(folder.parent, replace(general, name="a"), theta)
    for place in (folder, tmp_path / "a.safetensors"):
        with pytest.raises(ValueError, match=rf"^{place}: parameters .*{problem}; fit anew"):
            api.load(place)
    for words in (("view", folder), ("export", folder, "merl"), ("compare", folder, folder)):
        assert re.search(problem, metapp(*words).error), words
    assert not [*tmp_path.rglob("*.html"), *tmp_path.rglob("*.binary")]


@pytest.mark.parametrize(
    ("key", "value"),
    [("steps", "ten"), ("seed", 0.5), ("digest", []), ("versions", "1"), ("recipe", 3), ("device", {})],
)
def test_settings_of_another_kind_are_refused(general: api.Fit, tmp_path: Path, key: str, value: object) -> None:
    document = general.document()
    document["settings"][key] = value
    save_file(general.parameters, tmp_path / "a.safetensors", {RECORD: json.dumps(document)})
    folder = tmp_path / "run" / "a"
    write_fit(folder.parent, replace(general, name="a"), general.parameters)
    (folder / RECORD).write_text(json.dumps(document))
    for place in (folder, tmp_path / "a.safetensors"):
        with pytest.raises(ValueError, match=rf"^{place}.*Expected `.*`, got `.*` - at `\$\.settings\.{key}`"):
            api.load(place)


def test_completion_lists_the_api_alone() -> None:
    assert dir(api) == ["Fit", "__version__", "fit", "fit_all", "load"]


def test_a_fit_is_saved_exported_and_pickled(general: api.Fit, tmp_path: Path) -> None:
    saved = read_tensors(general.save(tmp_path / "below" / "a.safetensors"))
    again = pickle.loads(pickle.dumps(general))  # as programs that fit in several processes send it back
    for parameters in (saved, again.parameters):
        assert all(torch.equal(parameters[key], value) for key, value in general.parameters.items())
    assert (again.name, again.error, again.settings) == (general.name, general.error, general.settings)
    assert again.picture().tobytes() == general.picture().tobytes()
    assert general.export("nbrdf", tmp_path / "again") == tmp_path / "again"
    assert api.fit("brdf", tmp_path / "again", paradigm="general").name == "again"
    for form in ("bsdf", "osl"):
        for name in (f"gold.{form}", "gold.1"):  # the suffix may be given; what follows another dot is none
            file = general.export(form, tmp_path / form / name)
            assert file == tmp_path / form / f"{name.removesuffix(f'.{form}')}.{form}"
            assert file.is_file()
        assert {path.name for path in (tmp_path / form).iterdir()} == {f"gold.{form}", f"gold.1.{form}"}
    forms = "bsdf, bsdf-spectral, cpp, glsl, hlsl, materialx, merl, mitsuba, nbrdf, osl, wgsl"
    with pytest.raises(ValueError, match=f"--export 'blend': brdf expects one of {forms}"):
        general.export("blend", tmp_path / "x")


def write_by_name(fit: api.Fit, kind: str, folder: Path, **options: bool) -> Path:
    """Write a fit into a folder, by a method of `Fit` or in a form of `export`, and return the path."""
    if kind in ("save", "view"):
        path: Path = getattr(fit, kind)(folder / f"gold.{'html' if kind == 'view' else 'safetensors'}", **options)
        return path
    return fit.export(kind, folder / "gold", **options)


@pytest.mark.parametrize("kind", ["save", "view", "glsl", "merl", "materialx"])
def test_a_file_at_a_path_that_is_named_is_replaced_only_where_that_is_asked_for(
    kind: str, general: api.Fit, tmp_path: Path
) -> None:
    """Such a file may be the measurement that was fitted; files of other names beside it stay."""
    folder = tmp_path / "gold"
    path = write_by_name(general, kind, folder)
    first = path if path.is_file() else min(path.iterdir())
    whole = first.read_bytes()
    first.write_bytes(b"a measurement")
    (folder / "gold.txt").write_text("notes")
    files = sorted(folder.rglob("*"))
    with pytest.raises(FileExistsError) as refusal:
        write_by_name(general, kind, folder)
    assert says(str(refusal.value), str(first), "is there already", "overwrite=True")
    assert (first.read_bytes(), sorted(folder.rglob("*"))) == (b"a measurement", files)
    assert write_by_name(general, kind, folder, overwrite=True) == path
    assert first.read_bytes() == whole
    assert sorted(folder.rglob("*")) == files


@pytest.mark.filterwarnings("ignore:.* times the light that comes in")  # random networks
def test_several_tasks_are_a_list(write_nbrdf_networks: Callable[[int], Path]) -> None:
    folder = write_nbrdf_networks(2)
    fits = api.fit_all("brdf", [folder])
    assert len(fits) == 2
    assert all(f"{fit.name}: error {fit.error:.3f}" in repr(fits) for fit in fits)
    with pytest.raises(ValueError, match=r"2 tasks, expected one; take metapp\.fit_all"):
        api.fit("brdf", folder)
    samples = *directions(80), lambertian(*directions(80))
    fits = api.fit_all("brdf", [samples, lambertian, samples], paradigm="general")
    assert [fit.name for fit in fits] == ["object-1", "lambertian", "object-2"]  # numbered without a name


def test_the_traceback_of_bad_input_ends_at_the_call(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for app, source, message in (
        ("brdf", tmp_path / "none", "none: no such file or folder"),
        ("brfd", tmp_path, "brdf"),
    ):
        with pytest.raises(ValueError, match=message) as caught:
            api.fit(app, source)
        with monkeypatch.context() as patch:
            patch.setenv("METAPP_TRACEBACK", "1")
            with pytest.raises(ValueError, match=message) as whole:
                api.fit(app, source)
        assert [entry.name for entry in caught.traceback[1:]] == ["fit"]
        assert len(whole.traceback) > 4
        assert caught.value.__context__ is None


def test_nothing_is_printed_and_threads_stay(network: Path, capfd: pytest.CaptureFixture[str]) -> None:
    before = torch.get_num_threads()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert api.fit("brdf", network, paradigm="overfit", steps=1, seed=3).settings["steps"] == 1
    assert capfd.readouterr() == ("", "")
    assert torch.get_num_threads() == before


def test_the_package_imports_at_once() -> None:
    lines = "import sys, metapp\nprint({'torch', 'numpy', 'typer', 'rich'} & sys.modules.keys(), metapp.__version__)"
    process = subprocess.run([sys.executable, "-c", lines], capture_output=True, text=True, check=True)
    assert process.stdout.startswith("set()")
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = api.nothing


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
        constant = fit_by_general(
            "brdf", lambda wi, wo: np.broadcast_to(np.float32([0.3, 0.2, 0.1]), wi.shape)[:, ::-1]
        )
    assert constant.task.data["reflectance"][0].tolist() == pytest.approx([0.1, 0.2, 0.3])
    gray = fit_by_general("brdf", lambda wi, wo: torch.full((len(wi),), 0.1))
    assert torch.equal(gray.task.data["reflectance"][:, 0], gray.task.data["reflectance"][:, 2])


def test_a_bsdf_of_mitsuba_is_fitted() -> None:
    mi = load_mitsuba()
    fit = fit_by_general(
        "brdf", mi.load_dict({"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.2, 0.4, 0.6]}})
    )
    known = torch.tensor([0.2, 0.4, 0.6]) / np.pi
    torch.testing.assert_close(fit.task.data["reflectance"], known.expand(len(fit.task.data["angles"]), 3))


def test_an_anisotropic_fit_knows_the_azimuth() -> None:
    def brushed(wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        half = (wi + wo) / np.linalg.norm(wi + wo, axis=1, keepdims=True)
        return np.repeat(0.2 + 0.5 * half[:, :1] ** 2, 3, 1)

    fit = api.fit("brdf", brushed)
    wi, wo = directions(200)
    assert np.abs(fit(wi, wo) - brushed(wi, wo)).mean() < 0.02
    turned = [vectors[:, [1, 0, 2]] for vectors in (wi, wo)]
    assert np.abs(fit(*turned) - brushed(wi, wo)).mean() > 0.05


def test_a_fit_evaluates_its_application_above_the_surface(general: api.Fit) -> None:
    angles = torch.tensor([[0.3, 0.4, 1.0], [0.1, 0.9, 4.0]])
    pair = rusinkiewicz_to_directions(angles.double())
    values = general(*pair)
    torch.testing.assert_close(values, general.app.reflectance(general.parameters, angles), rtol=1e-4, atol=1e-6)
    again = general(*(directions.numpy() for directions in pair))
    assert again.dtype == np.float32
    np.testing.assert_array_equal(again, values.numpy())
    up, down = np.array([[0.0, 0.0, 1.0]]), np.array([[0.0, 0.0, -1.0]])
    assert not general(up, down).any()
    assert not general(down, up).any()
    assert general(up[:0], up[:0]).shape == (0, 3)


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
def test_a_fit_refuses_what_are_no_directions(general: api.Fit, wi: object, wo: object, line: str) -> None:
    with pytest.raises(ValueError, match=line):
        general(wi, wo)


ADDRESS = r"^s3:/bucket/gold\.binary: no such file or folder; give existing input files\.$"
REFUSED: tuple[tuple[str, object, dict[str, Any], str], ...] = (
    # things in memory: tests of readers have those of pictures, maps and light
    ("brdf", 3, {}, "object: int, expected a path, a function"),
    ("brdf", (1, 2), {}, "2 arrays, expected 3"),
    ("brdf", (np.zeros((0, 3)),) * 3, {}, "object: different pairs of directions: 0 of 0, expected 4 or more"),
    ("brdf", (np.zeros((9, 3)), *[np.ones((9, 3))] * 2), {}, "wi of length 0, expected unit vectors"),
    ("brdf", (*directions(3), np.ones((3, 3))), {}, "different pairs of directions: 3 of 3, expected 4"),
    ("brdf", (*directions(80), -np.ones((80, 3))), {}, "reflectance -1 in row 0, expected 0 to"),
    ("brdf", lambda wi, wo: wi[:, :2], {}, r"values \(\d+, 2\), expected"),
    ("brdf", lambda wi, wo: -np.abs(wi), {}, "reflectance of -1 /sr, expected 0 or more"),
    ("texture", np.zeros((40, 40, 3), np.uint8), {}, "^object: one colour all over"),
    ("texture", pictures.noise_image(20, 20), {}, "^object: 20x20 px, expected 32 px or more"),
    ("svbrdf_stationary", dict.fromkeys(("albedo", "normal"), pictures.noise_image(40, 40)), {},
     "^object: no roughness"),
    ("transport", "<scene", {}, "^object: not readable as XML"),
    # names as they were given
    ("brdf", "s3://bucket/gold.binary", {}, ADDRESS),
    ("brdf", "paint--old.binary", {}, r"^paint--old\.binary: no such file or folder"),
    # options: tests of options have more
    ("brdf", lambertian, {"paradigm": "magic"}, "paradigm 'magic': expected one of general"),
    ("brdf", lambertian, {"paradigm": 3}, "paradigm: 3, expected str"),
    ("brdf", lambertian, {"rule": "magic"}, r"^--rule: 'magic' is not a rule; expected one of"),
    ("brdf", lambertian, {"recipe": "paper", "rule": "meta-encoder"}, "train one with --train"),
    *(("brdf", lambertian, {name: value}, f"^{name}: an option of the command line")
      for name, value in {"train": True, "train_steps": 2, "resume": True, "export": "merl", "out": "runs"}.items()),
)  # fmt: skip


@pytest.mark.parametrize(("app", "source", "options", "line"), REFUSED)
def test_objects_that_cannot_be_fitted_are_refused_in_one_line(
    app: str, source: object, options: Any, line: str
) -> None:
    with pytest.raises(ValueError, match=line):
        api.fit(app, source, **({"recipe": "quick"} | options))


def test_sources_must_be_all_paths_or_all_objects() -> None:
    one = r"^\w+: one source, expected a list of them; take metapp\.fit for one"
    for source in ("a.png", Path("a.png"), lambertian, {"diffuse": 1}, 3, np.ones((3, 2)), torch.ones(3, 2)):
        with pytest.raises(ValueError, match=one):
            api.fit_all("texture", source)
    for sources, line in (
        (["a", lambertian], "1 of 2 inputs are objects in memory, expected all or none"),
        (list(np.ones((3, 2))), r"object-1: ndarray, expected a path, a function"),
        ([], "0 sources, expected a list of one or more"),
    ):
        with pytest.raises(ValueError, match=line):
            api.fit_all("brdf", sources)


# What is in memory is fitted as files are


def assert_same(fit: api.Fit, other: api.Fit) -> None:
    """Two fits saw the same and came to the same, bit by bit."""
    assert (fit.name, fit.error) == (other.name, other.error)
    assert fit.settings | {"data": ""} == other.settings | {"data": ""}  # of files by their paths
    for result, known in ((fit.task.data, other.task.data), (fit.parameters, other.parameters)):
        assert result.keys() == known.keys()
        assert all(torch.equal(value, known[key]) for key, value in result.items())


def test_a_material_in_memory_is_that_of_its_files(tmp_path: Path) -> None:
    maps = {
        name: pictures.noise_image(64, 64, seed=seed) for seed, name in enumerate(("diffuse", "specular", "roughness"))
    }
    maps["normal"] = np.full_like(maps["diffuse"], (128, 128, 255))
    for name, values in maps.items():
        pictures.write_image(tmp_path / "files" / f"object_{name}.png", values)
    fit = fit_by_general("svbrdf_nonstationary", maps)
    assert_same(fit, fit_by_general("svbrdf_nonstationary", tmp_path / "files"))
    again = fit_by_general("svbrdf_nonstationary", fit.maps)  # what a fit gives is what another takes
    for part, name in (slice(3), "normal"), (slice(3, 6), "diffuse"), (slice(6, 7), "roughness"):
        given = torch.from_numpy(np.atleast_3d(fit.maps[name])).permute(2, 0, 1)
        assert (again.task.data["maps"][part].float() - given).abs().max() < 2e-3, name


def test_a_photo_in_memory_is_fitted_alone(tmp_path: Path) -> None:
    pixels = pictures.noise_image(64, 64)
    file = pictures.write_image(tmp_path / "object.png", pixels)
    fit = fit_by_general("svbrdf_nonstationary", pixels)
    assert_same(fit, fit_by_general("svbrdf_nonstationary", file))
    darker = fit_by_general("svbrdf_nonstationary", pixels, stops=1.0)
    assert_same(darker, fit_by_general("svbrdf_nonstationary", file, stops=1.0))
    assert darker.task.data["photo"].float().mean() < 0.8 * fit.task.data["photo"].float().mean()
    with pytest.raises(ValueError, match="object: a flash photo, expected a material's maps"):
        fit_by_general("svbrdf_nonstationary", pixels, observe="reference")
    assert (fit.error, fit.picture().width) == (None, fit.picture().height * 2)  # a sheet without a reference
    with pytest.raises(ValueError, match="object: a fit of svbrdf_nonstationary, expected one of brdf"):
        fit(*directions(2))


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
    fit = fit_by_general("transport", tmp_path / "here" / "object.xml")
    monkeypatch.chdir(tmp_path / "here")
    again = fit_by_general("transport", text)
    assert_same(again, fit)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    with pytest.raises(ValueError, match=r"object: names the file 'corner.obj': file not found"):
        fit_by_general("transport", text)
    assert fit_by_general("transport", text, scene_root=str(tmp_path)).error == pytest.approx(fit.error, abs=1e-6)


def pictures_in(html: str) -> list[Image.Image]:
    urls = re.findall(r'src="data:image/png;base64,([^"]+)"', html)
    return [Image.open(io.BytesIO(base64.b64decode(url))) for url in urls]


@pytest.mark.usefixtures("compiled_in_cache")
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
    assert set(fit.preview()) == {"reference", "fit"}
    reference = composite_to_srgb(fit.preview()["reference"])
    assert np.abs(np.asarray(picture)[:, :96] - 255 * reference).max() <= 0.5 + 1e-4
    fit.name, fit.warning = "<b>", "1 < 2"  # names and warnings are text
    html = fit._repr_html_()
    assert "&lt;b&gt;" in html
    assert "warning: 1 &lt; 2" in html


def test_suns_of_which_a_part_is_missing_are_refused() -> None:
    app = app_by_recipe("illumination")
    theta = {key: value[0] for key, value in app.init(Generator().manual_seed(0), 1).items()}
    suns = {key: torch.zeros(spec.shape) for key, spec in SUN_SPECS.items()}
    check_params(theta, app, "sky")
    check_params(theta | suns, app, "sky")
    for key in suns:
        others = {name: value for name, value in suns.items() if name != key}
        with pytest.raises(ValueError, match=rf"^sky: parameters without '{key}', but with others of suns\.\*; fit"):
            check_params(theta | others, app, "sky")
