"""The recipe and protocol that inputs and options choose for each application, and the lines that give the reason."""

import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch

from data_tools.readers import gonio
from data_tools.readers.merl import FILE_BYTES
from data_tools.readers.square_photos import CAMERA_TEXT, LIGHT_TEXT
from data_tools.synthetic.svbrdf_nonstationary import synthetic_tasks
from metapp.extensions.rgl.tensor_file import write_tensor_file
from metapp.learning.task import Task
from metapp.options import BadOption
from metapp.storage.shards import write_data_set
from tests.anisotropic import measure_with_noise
from tests.kept_fits import resolve_inputs
from tests.pictures import write_planes

MATERIALS, BALLS = "svbrdf_nonstationary", "illumination"
LACKING = "the weights of VGG-16 are missing: maps by a smaller network; metapp data vgg gets them"


class Case(NamedTuple):
    """Inputs of a fit and its options, and what they choose: a recipe and a protocol for each input, or for all."""

    app: str
    inputs: str = ""  # names in the folder of inputs, apart by spaces
    options: dict[str, Any] = {}  # noqa: RUF012  (nobody changes it)
    recipe: str = "full"
    protocol: str = ""
    lines: tuple[str, ...] = ()


def table(folder: Path, name: str, rows: int, *, anisotropic: bool) -> None:
    pairs = measure_with_noise(rows, anisotropic=anisotropic)
    gonio.write_pairs(folder / f"{name}.csv", pairs.wi[:0], pairs.wo[:0], pairs)


def picture(path: Path, seed: int, width: int = 48, kind: str = "uint8") -> Path:
    path.parent.mkdir(exist_ok=True)
    return write_planes(path, torch.rand(3, 48, width, generator=torch.Generator().manual_seed(seed)), kind)


def data_set(folder: Path, app: str, *tasks: Task) -> None:
    units = dict.fromkeys({key for task in tasks for key in task.data}, "-")
    write_data_set(folder, app, units, [(task, "test", "") for task in tasks])


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All the inputs that the table names, in one folder."""
    folder = tmp_path_factory.mktemp("inputs")
    for name, rows, anisotropic in (("brushed", 2000, True), ("plain", 500, False), ("paint", 20, False)):
        table(folder, name, rows, anisotropic=anisotropic)
    table(folder, "brushed150", 150, anisotropic=True)
    (folder / "damaged.csv").write_text("theta_i_deg,phi_i_deg\n1,x\n")
    for name, held in {
        "fews": ("paint", "damaged"), "some": ("paint", "plain"), "turned": ("brushed", "plain"),
    }.items():  # fmt: skip
        (folder / name).mkdir()
        for other in held:
            shutil.copy(folder / f"{other}.csv", folder / name)
    for name, azimuths in (("satin", 17), ("flat", 1)):
        write_tensor_file(folder / f"{name}.bsdf", {"phi_i": np.zeros(azimuths, np.float32)})
    with (folder / "gold.binary").open("wb") as file:
        file.write(np.array([90, 90, 180], "<i4").tobytes())
        file.truncate(FILE_BYTES)
    picture(folder / "wall.png", 1)
    picture(folder / "photos" / "a.png", 2)
    picture(folder / "photos" / "b.png", 3)
    picture(folder / "strip.png", 4, 240)
    for role in ("diffuse", "normal", "roughness"):
        picture(folder / "rock" / f"rock_{role}.png", 5)
    shutil.copytree(folder / "rock", folder / "mixed")
    picture(folder / "mixed" / "wall.png", 6)
    for name in ("a", "b", "c"):
        picture(folder / "leaf" / f"{name}.png", 7)
    (folder / "leaf" / CAMERA_TEXT).write_text("0,0,16\n" * 3)
    (folder / "leaf" / LIGHT_TEXT).write_text("0,2,16\n" * 3)
    shutil.copytree(folder / "leaf", folder / "leaves" / "leaf")
    shutil.copy(folder / "wall.png", folder / "leaves")
    picture(folder / "sky.exr", 8, 96, "float")
    (folder / "box.xml").write_text("<scene/>")
    samples = {"angles": torch.rand(8, 3), "reflectance": torch.rand(8, 3)}
    data_set(folder / "isotropic", "brdf", Task("a", samples))
    data_set(folder / "anisotropic", "brdf", Task("a", samples | {"phi_h": torch.rand(8)}))
    (drawn,) = synthetic_tasks("test", 1, 0)
    photo = {"photo": drawn.data["photo"]}
    several = photo | {"others": photo["photo"][None], "places": torch.rand(2, 2, 3)}
    data_set(folder / "maps", MATERIALS, drawn)
    data_set(folder / "shots", MATERIALS, Task("a", photo))
    data_set(folder / "places", MATERIALS, Task("a", several))
    return folder


def line_of(app: str, recipe: str, count: str = "") -> str:
    return f"{app}: recipe {recipe}, as the input has {WORDS[recipe]}" + (f" ({count} inputs)" if count else "")


WORDS = {
    "few": "200 samples or fewer",
    "anisotropic": "reflectance that depends on phi_h",
    "pretrained": "one flash photo",
    "several": "several photos",
}
TURNED, FEWER = (line_of("brdf", "anisotropic"),), (line_of("brdf", "few"),)
ONE_PHOTO, SEVERAL = (line_of(MATERIALS, "pretrained"),), (line_of(MATERIALS, "several"),)
ONE_OF_TWO = (line_of(MATERIALS, "pretrained", "1 of 2"),)
BOTH = (line_of(MATERIALS, "several", "1 of 2"), line_of(MATERIALS, "pretrained", "1 of 2"))

CASES = [
    # BRDFs: measurements that depend on phi_h, few ones, others
    Case("brdf", "brushed.csv", {}, "anisotropic", "", TURNED),
    Case("brdf", "brushed.csv", {"paradigm": "overfit"}, "anisotropic", "", TURNED),
    Case("brdf", "brushed.csv", {"paradigm": "general"}),
    Case("brdf", "brushed.csv", {"paradigm": "finetune"}),
    Case("brdf", "brushed.csv", {"paradigm": "quickft"}),
    Case("brdf", "brushed.csv", {"recipe": "full"}),
    Case("brdf", "brushed150.csv", {}, "anisotropic", "", TURNED),
    Case("brdf", "satin.bsdf brushed.csv", {}, "anisotropic", "", TURNED),
    Case("brdf", "flat.bsdf"),
    Case("brdf", "plain.csv"),
    Case("brdf", "gold.binary plain.csv"),
    Case("brdf", "paint.csv", {}, "few", "", FEWER),
    Case("brdf", "paint.csv", {"paradigm": "overfit"}),
    Case("brdf", "paint.csv", {"recipe": "paper"}, "paper"),
    # each input has what it would have alone; of a damaged one nothing is known
    Case("brdf", "fews", {}, "full few", "", (line_of("brdf", "few", "1 of 2"),)),
    Case("brdf", "some", {}, "few full", "", (line_of("brdf", "few", "1 of 2"),)),
    Case("brdf", "turned", {}, "anisotropic full", "", (line_of("brdf", "anisotropic", "1 of 2"),)),
    Case("brdf", "turned", {"recipe": "anisotropic"}, "anisotropic"),
    Case("brdf", "paint.csv plain.csv", {}, "few full", "", (line_of("brdf", "few", "1 of 2"),)),
    Case("brdf", "paint.csv brushed.csv", {}, "few anisotropic", "",
         (line_of("brdf", "few", "1 of 2"), line_of("brdf", "anisotropic", "1 of 2"))),
    Case("brdf", "plain.csv brushed.csv", {"paradigm": "general"}),
    Case("brdf", options={"data": "isotropic"}, recipe="few", lines=FEWER),
    Case("brdf", "isotropic", recipe="few", lines=FEWER),
    Case("brdf", "isotropic plain.csv", recipe="few full", lines=(line_of("brdf", "few", "1 of 2"),)),
    Case("brdf", options={"data": "anisotropic"}, recipe="anisotropic", lines=TURNED),
    Case("brdf", "plain.csv", {"data": "anisotropic"}),
    # applications of one kind of input
    Case("texture", "wall.png"),
    Case("texture", "photos wall.png", {"recipe": "quick"}, "quick"),
    Case("svbrdf_stationary", "photos"),
    Case("svbrdf_stationary", "wall.png", {"recipe": "paper-64"}, "paper-64"),
    Case("transport", "box.xml"),
    # maps and flash photographs, one or several of a place
    Case(MATERIALS, "rock", protocol="reference"),
    Case(MATERIALS, "strip.png rock", protocol="reference"),
    Case(MATERIALS, "wall.png", {}, "pretrained", "photo", ONE_PHOTO),
    Case(MATERIALS, "photos", {"paradigm": "general"}, "pretrained", "photo", ONE_PHOTO),
    Case(MATERIALS, "wall.png", {"paradigm": "overfit"}, "full", "photo"),
    Case(MATERIALS, "wall.png", {"lacking": True}, "full", "photo", (f"{MATERIALS}: {LACKING}",)),
    Case(MATERIALS, "wall.png", {"recipe": "full"}, "full", "photo"),
    Case(MATERIALS, "wall.png", {"observe": "photo"}, "pretrained", "photo", ONE_PHOTO),
    Case(MATERIALS, "wall.png", {"observe": "photo", "recipe": "quick"}, "quick", "photo"),
    Case(MATERIALS, "wall.png", {"observe": "reference"}, "full", "reference"),
    Case(MATERIALS, "strip.png", {"observe": "photo"}, "pretrained", "photo", ONE_PHOTO),
    Case(MATERIALS, "rock wall.png", {}, "full pretrained", "reference photo", ONE_OF_TWO),
    Case(MATERIALS, "mixed", {}, "full pretrained", "reference photo", ONE_OF_TWO),
    Case(MATERIALS, "leaf", {}, "several", "photo", SEVERAL),
    Case(MATERIALS, "leaf", {"paradigm": "overfit"}, "several", "photo", SEVERAL),
    Case(MATERIALS, "leaf", {"lacking": True}, "several", "photo", SEVERAL),
    Case(MATERIALS, "leaf/a.png", {}, "pretrained", "photo", ONE_PHOTO),
    Case(MATERIALS, "leaf wall.png", {}, "several pretrained", "photo", BOTH),
    Case(MATERIALS, "leaves", {}, "several pretrained", "photo", BOTH),
    Case(MATERIALS, "leaf wall.png", {"recipe": "several"}, "several", "photo"),
    Case(MATERIALS, "leaf wall.png", {"observe": "reference"}, "full", "reference"),
    Case(MATERIALS, "", {"data": "maps"}, "full", "reference"),
    Case(MATERIALS, "", {"data": "maps", "observe": "photo"}, "pretrained", "photo", ONE_PHOTO),
    Case(MATERIALS, "", {"data": "shots"}, "pretrained", "photo", ONE_PHOTO),
    Case(MATERIALS, "", {"data": "places"}, "several", "photo", SEVERAL),
    # environment maps, and photographs of balls
    Case(BALLS, "sky.exr", {}, "full", "reference"),
    Case(BALLS, "wall.png", {}, "full", "photo"),
    Case(BALLS, "photos", {"shutter": "auto"}, "full", "photo"),
    Case(BALLS, "sky.exr wall.png", {}, "full", "reference photo"),
    Case(BALLS, "wall.png", {"observe": "reference"}, "full", "reference"),
    Case(BALLS, "sky.exr", {"recipe": "paper"}, "paper", "reference"),
]  # fmt: skip


def name_of(case: Case) -> str:
    words = [f"{key}={value}" for key, value in case.options.items()]
    return " ".join(filter(None, (case.app, case.inputs, *words)))


def each(words: str, count: int) -> list[str]:
    """A word for each input; one word holds for all."""
    return (words.split() or [""]) * (1 if len(words.split()) > 1 else count)


@pytest.mark.parametrize("case", CASES, ids=name_of)
def test_inputs_and_options_choose_recipe_and_protocol(
    case: Case, inputs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    options = dict(case.options)
    line = LACKING if options.pop("lacking", False) else ""
    monkeypatch.setattr("metapp.apps.svbrdf_nonstationary.pretrained.encoder.describe_missing_weights", lambda: line)
    monkeypatch.chdir(inputs)
    specs, lines = resolve_inputs(case.app, *map(Path, case.inputs.split()), **options)
    assert [spec.recipe for spec in specs] == each(case.recipe, len(specs))
    assert [spec.observe for spec in specs] == each(case.protocol, len(specs))
    assert tuple(lines) == case.lines


def test_a_recipe_that_fits_of_what_is_observed_lack_is_refused(inputs: Path) -> None:
    with pytest.raises(BadOption, match="--recipe 'pretrained': expected one of"):
        resolve_inputs(MATERIALS, inputs / "wall.png", observe="reference", recipe="pretrained")


def test_inputs_that_are_fitted_alike_have_one_specification(inputs: Path) -> None:
    """A map beside a photograph is fitted as it is alone."""
    specs, _ = resolve_inputs(BALLS, inputs / "sky.exr", inputs / "wall.png", inputs / "photos")
    alone, _ = resolve_inputs(BALLS, inputs / "sky.exr")
    assert specs[0] == alone[0]
    assert len({id(spec) for spec in specs}) == 2


@pytest.mark.parametrize(
    ("app", "folder"),
    [("brdf", "fews"), ("texture", "photos"), ("svbrdf_stationary", "photos"), (BALLS, "photos"), (MATERIALS, "mixed"),
     (MATERIALS, "leaf")],
)  # fmt: skip
def test_a_folder_is_listed_once(app: str, folder: str, inputs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    listed: list[str] = []
    for name in ("scandir", "listdir"):
        real = getattr(os, name)

        def count(path: Any = ".", real: Any = real) -> Any:
            listed.append(os.path.abspath(path))
            return real(path)

        monkeypatch.setattr(os, name, count)
    assert resolve_inputs(app, inputs / folder, paradigm="general")[0]
    assert listed.count(str(inputs / folder)) == 1


def test_files_that_come_later_are_found_by_the_next_command(tmp_path: Path) -> None:
    for seed in (1, 2):
        picture(tmp_path / f"{seed}.png", seed)
        assert len(resolve_inputs("texture", tmp_path, paradigm="general")[0]) == seed


def pairs(rows: int, *, anisotropic: bool = False) -> Any:
    return tuple(measure_with_noise(rows, anisotropic=anisotropic))


PIXELS = np.random.default_rng(0).random((48, 48, 3)).astype(np.float32)
MAPS = {"diffuse": PIXELS, "normal": np.broadcast_to(np.float32([0, 0, 1]), (48, 48, 3)), "roughness": PIXELS[..., 0]}
OBJECTS: dict[str, tuple[str, Callable[[], list[Any]], str, str]] = {  # application, objects, recipe, protocol
    "a function": ("brdf", lambda: [lambda wi, wo: np.full((len(wi), 3), 0.1)], "full", ""),
    "many pairs": ("brdf", lambda: [pairs(500)], "full", ""),
    "few pairs": ("brdf", lambda: [pairs(200)], "few", ""),
    "all few": ("brdf", lambda: [pairs(20), pairs(30)], "few", ""),
    "pairs that turn": ("brdf", lambda: [pairs(2000, anisotropic=True)], "anisotropic", ""),
    "a picture": ("texture", lambda: [PIXELS], "full", ""),
    "a flash photo": (MATERIALS, lambda: [PIXELS], "pretrained", "photo"),
    "maps": (MATERIALS, lambda: [MAPS], "full", "reference"),
    "maps and a photo": (MATERIALS, lambda: [MAPS, PIXELS], "full pretrained", "reference photo"),
    "a map": (BALLS, lambda: [np.random.default_rng(0).random((32, 64, 3)).astype(np.float32)], "full", "reference"),
}  # fmt: skip


@pytest.mark.usefixtures("small_spheres")
@pytest.mark.parametrize("name", OBJECTS)
def test_objects_in_memory_choose_recipe_and_protocol(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("metapp.apps.svbrdf_nonstationary.pretrained.encoder.describe_missing_weights", lambda: "")
    app, objects, recipe, protocol = OBJECTS[name]
    specs, lines = resolve_inputs(app, *objects())
    assert [spec.recipe for spec in specs] == each(recipe, len(specs))
    assert [spec.observe for spec in specs] == each(protocol, len(specs))
    assert len(lines) == sum(word in WORDS for word in recipe.split())


def test_objects_of_several_kinds_have_a_recipe_each() -> None:
    specs, _ = resolve_inputs("brdf", pairs(20), pairs(500))
    assert [spec.recipe for spec in specs] == ["few", "full"]
    specs, _ = resolve_inputs("brdf", pairs(20), pairs(500), recipe="full")
    assert [spec.recipe for spec in specs] == ["full", "full"]
