"""Folders of photos with the places of camera and flash: one input of non-stationary svBRDFs, and clear refusals."""

import os
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest
import torch
from torch import Generator

from data_tools.readers import placed_photos as photos
from data_tools.readers import svbrdf_inputs
from data_tools.readers.square_photos import CAMERA_TEXT, LIGHT_TEXT, SIZE_TEXT
from data_tools.synthetic.svbrdf_nonstationary import synthetic_tasks
from metapp.learning.app import stack_tasks
from metapp.learning.task import Task
from metapp.paradigms.methods import fit_tasks
from metapp.runs.fitting import Fitter
from metapp.runs.resolve import complete, suiting_recipe
from metapp.runs.spec import Spec
from metapp.storage.checkpoint_files import read_entry, read_headers, tensor_digest
from metapp.storage.shards import write_data_set
from metapp.storage.shipped_checkpoints import shipped_checkpoint_path
from tests.kept_fits import resolve_inputs
from tests.recipe_apps import application, input_formats, recipes_of

APP = "svbrdf_nonstationary"


def write(path: Path, seed: int, height: int = 48, width: int = 48) -> Path:
    pixels = np.random.default_rng(seed).integers(0, 255, (height, width, 3), dtype=np.uint8)
    oiio.ImageBuf(np.ascontiguousarray(pixels)).write(str(path))
    return path


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Three photos, written in another order than that of their names."""
    result = tmp_path / "leaf"
    result.mkdir()
    for name, seed in (("c.png", 3), ("a.png", 1), ("b.png", 2)):
        write(result / name, seed)
    (result / CAMERA_TEXT).write_text("0,0,16\n1,0,16\n2,0,16\n\n")
    (result / LIGHT_TEXT).write_text("0,2,16\n-2,4,8\n0,0,16\n")
    (result / SIZE_TEXT).write_text("8\n")
    (result / "light_power.txt").write_text("1500,1500,1500\n")
    return result


def test_equal_photographs_of_several_places_are_said(folder: Path) -> None:
    write(folder / "b.png", 1)
    with pytest.warns(UserWarning, match="leaf: some photos are equal, expected one from each place"):
        photos.read_task(folder)


def test_a_folder_is_one_task_in_the_order_of_names(folder: Path, recwarn: pytest.WarningsRecorder) -> None:
    task = photos.read_task(folder)
    assert not recwarn
    assert task.name == "leaf"
    assert {key: tuple(value.shape) for key, value in task.data.items()} == {
        "photo": (3, 256, 256), "others": (2, 3, 256, 256), "places": (3, 2, 3),
    }  # fmt: skip
    alone = [svbrdf_inputs.read_task(folder / f"{name}.png").data["photo"] for name in "abc"]
    assert torch.equal(torch.cat([task.data["photo"][None], task.data["others"]]), torch.stack(alone))
    camera, light = task.data["places"].unbind(1)  # in half sides
    torch.testing.assert_close(camera, torch.tensor([[0.0, 0, 4], [0.25, 0, 4], [0.5, 0, 4]]))
    torch.testing.assert_close(light, torch.tensor([[0.0, 0.5, 4], [-0.5, 1, 2], [0, 0, 4]]))


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_texts_that_windows_wrote_are_those_of_unix(folder: Path, encoding: str) -> None:
    before = photos.read_places(folder, 3)
    for name in (CAMERA_TEXT, LIGHT_TEXT, SIZE_TEXT):
        text = (folder / name).read_text().replace("\n", "\r\n")
        (folder / name).write_bytes(text.encode(encoding))
    assert torch.equal(photos.read_places(folder, 3), before)


def inputs_by_format(path: Path) -> list[tuple[str, Path]]:
    """What each format of the application finds in a path that it recognises."""
    modules = {name: form.load() for name, form in input_formats(APP).items()}
    readers = {name: module for name, module in modules.items() if module.recognises(path)}
    return [(name, source.path) for name, module in readers.items() for source in module.find(path)[0]]


def test_photos_in_folders_without_positions_are_single_inputs(folder: Path) -> None:
    assert inputs_by_format(folder) == [("placed", folder)]
    assert inputs_by_format(folder / "b.png") == [("svbrdf", folder / "b.png")]
    assert inputs_by_format(folder.parent) == [("placed", folder)]
    plain = write(folder.parent / "wall.png", 4)
    assert inputs_by_format(folder.parent) == [("placed", folder), ("svbrdf", plain)]
    for name in (CAMERA_TEXT, LIGHT_TEXT):
        (folder / name).unlink()
    assert [name for name, _ in inputs_by_format(folder)] == ["svbrdf"] * 3


@pytest.fixture(params=["", "no weights"])
def missing_weights(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """What the recipe of one photo, `pretrained`, finds missing."""
    monkeypatch.setattr(
        "metapp.apps.svbrdf_nonstationary.pretrained.encoder.describe_missing_weights", lambda: request.param
    )
    lack: str = request.param
    return lack


def test_folders_with_places_have_a_recipe_of_their_own(folder: Path, missing_weights: str) -> None:
    one = "full" if missing_weights else "pretrained"

    def recipe(*inputs: Path, observe: str = "photo") -> str:
        (found,) = {spec.recipe for spec in resolve_inputs(APP, *inputs, paradigm="general", observe=observe)[0]}
        return found

    assert recipe(folder) == recipe(folder.parent) == "several"
    assert recipe(folder / "a.png") == one
    assert recipe(folder, folder / "a.png", observe="reference") == "full"


def test_data_sets_and_tasks_of_several_photos_have_that_recipe(
    folder: Path, tmp_path: Path, missing_weights: str
) -> None:
    task = photos.read_task(folder)
    write_data_set(tmp_path / "set", APP, dict.fromkeys(task.data, "-"), [(task, "test", "")])
    (spec,), _ = resolve_inputs(APP, observe="photo", data=tmp_path / "set")
    assert spec.recipe == "several"

    def recipe(tensors: dict[str, torch.Tensor]) -> str:
        return suiting_recipe(Spec(app=APP), "photo", application(APP).describe_tensors(tensors))[0]

    assert recipe(task.data) == "several"
    assert recipe({"photo": task.data["photo"]}) == ("full" if missing_weights else "pretrained")


def test_a_folder_tells_how_many_photos_it_holds(folder: Path) -> None:
    (source,), _ = photos.find(folder)
    assert (source.name, source.facts) == ("leaf", {"photos": 3, "reference": False})
    assert application(APP).describe_tensors(photos.read_task(folder).data) == {"photos": 3, "reference": False}


def test_folders_with_places_and_single_photos_have_a_recipe_each(folder: Path, missing_weights: str) -> None:
    """Or one recipe that is asked for; whether they are named or found in one folder."""
    plain = write(folder.parent / "wall.png", 4)
    one = "full" if missing_weights else "pretrained"
    for inputs, recipes in (
        ((folder, plain), ["several", one]),
        ((plain, folder), [one, "several"]),
        ((folder.parent, plain), None),
    ):
        specs, _ = resolve_inputs(APP, *inputs, observe="photo", paradigm="general")
        found = [spec.recipe for spec in specs]
        assert found == recipes or sorted(found) == sorted(["several", one])
        for recipe in ("full", "several"):
            specs, lines = resolve_inputs(APP, *inputs, observe="photo", recipe=recipe)
            assert ({spec.recipe for spec in specs}, lines) == ({recipe}, [])


def test_fits_name_the_recipe_that_inputs_choose(folder: Path, metapp: Callable) -> None:
    result = metapp("general", APP, folder, "--observe", "photo", "--out", folder.parent / "runs", "--json")
    assert result.code == 0, result.err
    assert f"{APP}: recipe several, as the input has several photos\n" in result.err
    assert result.json_document["tasks"][0]["counts"] == {"photos": 3}
    assert re.search(r"^relief: mean tilt \d+\.\d degrees$", result.err, re.MULTILINE)
    output_folder = Path(result.json_document["out"]) / "leaf"
    assert {f"photo_{i}.png" for i in (1, 2, 3)} <= {path.name for path in output_folder.iterdir()}
    refused = metapp("general", APP, folder, "--observe", "reference", "--out", folder.parent / "runs").error
    assert "leaf: a flash photo, expected a material's maps" in refused
    assert "leave --observe reference out" in refused


def pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


TEXTS = [
    (CAMERA_TEXT, "1,0,16\n", "camera_pos.txt: 1 lines, expected 3; give one for each photo"),
    (LIGHT_TEXT, "1,0\n1,0,3\n1,0,3\n", "light_pos.txt: line '1,0', expected 3 finite"),
    (LIGHT_TEXT, "1,0,nan\n1,0,3\n1,0,3\n", "expected 3 finite"),
    (CAMERA_TEXT, "1,0,5\n1,0,-3\n1,0,5\n", "place 2 has z -3 cm"),
    (SIZE_TEXT, "0\n", "image_size.txt: 0, expected the patch's side in cm, 1e-05 to 100000"),
    (SIZE_TEXT, "1e300\n", "1e+300, expected the patch's side"),
    (LIGHT_TEXT, "1,0,1e39\n1,0,3\n1,0,3\n", "place 1 is 1e+39 cm away, expected 8000 at most"),
    (SIZE_TEXT, "wide\n", "line 'wide', expected 1 finite"),
]


@pytest.mark.parametrize(
    ("change", "line"),
    [
        *((lambda at, name=name, text=text: (at / name).write_text(text), line) for name, text, line in TEXTS),
        (
            lambda at: pipe(at / CAMERA_TEXT),
            f"{CAMERA_TEXT}: a pipe or device, expected a file",
        ),  # which is not waited for
        (lambda at: (at / LIGHT_TEXT).unlink(), "light_pos.txt: cannot be read as text, expected lines in cm: 3"),
        (lambda at: (at / SIZE_TEXT).unlink(), "image_size.txt: cannot be read as text"),
        (lambda at: write(at / "b.png", 2, 48, 64), "b.png: 64 x 48 px, expected square photos of one size"),
        (lambda at: write(at / "b.png", 2, 64, 64), "b.png: 64 x 64 px, expected square photos of one size"),
        (lambda at: (at / "b.png").write_bytes(b"no image"), "b.png"),
        (lambda at: [(at / f"{name}.png").unlink() for name in "bc"], "leaf: 1 photo beside places"),
    ],
)
def test_bad_folders_are_refused_in_a_line(folder: Path, change: Callable[[Path], object], line: str) -> None:
    change(folder)
    with pytest.raises(ValueError, match=re.escape(line)) as caught:
        photos.read_task(folder)
    assert "\n" not in str(caught.value)


# Its checkpoints


def test_general_of_several_photos_ships_with_its_adam_and_rule() -> None:
    path, others = shipped_checkpoint_path(APP, "several"), ("gauss-newton-photo", "quickft-photo")
    assert sorted(read_headers(path)) == sorted(("general-photo", *others))
    encoder = read_entry(path, "general-photo")[0].encoder
    for name in others:
        prepared, info = read_entry(path, name)
        assert info["encoder_of"] == "general-photo"
        assert (info["recipe"], info["observe"], info["encoder"]) == ("several", "photo", tensor_digest(encoder))
        assert info["inner_steps"] == recipes_of(APP, "photo")["several"].steps
        assert tensor_digest(prepared.encoder) == tensor_digest(encoder)


@pytest.mark.slow
def test_fits_of_five_photos_have_lower_errors_than_fits_of_one() -> None:
    """Checkpoints that ship are compared: one photo by its default recipe, five by that of folders with positions."""
    tasks = list(synthetic_tasks("test", 3, size=256, photos=5))
    errors = {}
    for recipe, paradigm in (("full", "meta"), ("several", "general"), ("several", "quickft"), ("several", "meta")):
        by = Fitter.of(complete(Spec(app=APP, paradigm=paradigm, observe="photo", recipe=recipe)))
        of = tasks if recipe == "several" else [Task(t.name, {k: t.data[k] for k in ("photo", "maps")}) for t in tasks]
        theta = [fit_tasks(by.method, stack_tasks(by.app, [task]), Generator()) for task in of]
        found = [by.app.errors(parameters, stack_tasks(by.app, [t])) for parameters, t in zip(theta, of, strict=True)]
        errors[recipe, paradigm] = {
            key: sum(float(errors_of_task[key]) for errors_of_task in found) / len(found) for key in ("error", "normal")
        }
    meta = errors["several", "meta"]
    assert meta["error"] < 0.9 * errors["several", "general"]["error"]
    assert meta["error"] < errors["several", "quickft"]["error"]
    for key in ("error", "normal"):
        assert meta[key] < 0.6 * errors["full", "meta"][key]


def test_of_many_photos_nine_of_different_directions_are_read(folder: Path) -> None:
    angles = torch.arange(20) * 0.3
    xs, ys = (angles / 6 * angles.cos() * 8).tolist(), (angles / 6 * angles.sin() * 8).tolist()
    for index in range(20):
        write(folder / f"p{index:02}.png", index)
    for name in ("a.png", "b.png", "c.png"):
        (folder / name).unlink()
    for name in (CAMERA_TEXT, LIGHT_TEXT):
        (folder / name).write_text("".join(f"{x},{y},16\n" for x, y in zip(xs, ys, strict=True)))
    task, places = photos.read_task(folder, 48), photos.read_places(folder, 20)
    chosen = photos.choose_spread(places, photos.MAX_PHOTOS)
    assert len(task.data["others"]) == len(chosen) - 1 == 8
    assert chosen == sorted(set(chosen))
    assert {0, 19} <= set(chosen)
    torch.testing.assert_close(task.data["places"], places[chosen])
    assert task.note.startswith("20 photos, more than a fit sees")
    assert all(f"p{index:02}.png" in task.note for index in chosen)
    same = photos.choose_spread(torch.ones(12, 2, 3), 9)
    assert len(set(same)) == 9
    assert photos.choose_spread(places[:9], 9) == list(range(9))
