"""The recipe and protocol that inputs and options choose for each application, and the lines that give the reason."""

import os
import re
import shutil
from collections.abc import Callable, Sequence
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
from metapp.registry import registry
from metapp.runs.choice import choose_recipe, find_and_choose
from metapp.runs.fit_options import fit_options
from metapp.runs.inputs.finding import source_of_tensors
from metapp.runs.inputs.run_inputs import find_inputs
from metapp.runs.reporter import Reporter, use_reporter
from metapp.storage.shards import write_data_set
from tests.anisotropic import measure_with_noise
from tests.pictures import write_planes
from tests.recipe_apps import application

MATERIALS, BALLS = "svbrdf_nonstationary", "illumination"
PHI_H, FEW = "reflectance that depends on phi_h", "200 samples or fewer"
LACKING = "the weights of VGG-16 are missing: maps by a smaller network; metapp data vgg gets them"


class Case(NamedTuple):
    """Inputs of a fit and its options, and what they choose; `mistake` is the error in place of a choice."""

    app: str
    inputs: str = ""  # names in the folder of inputs, apart by spaces
    options: dict[str, Any] = {}  # noqa: RUF012  (nobody changes it)
    recipe: str = "full"
    protocol: str = ""
    reasons: tuple[str, ...] = ()
    mistake: str = ""


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


def reason_of(app: str, recipe: str, why: str, what: str = "input") -> str:
    return f"{app}: recipe {recipe}, since every {what} has {why}"


def some_hold_photos_alone(app: str = MATERIALS) -> str:
    return f"{app}: fits see: photo, since 1 of 2 inputs hold a photo alone"


ONE_PHOTO, ONE_OF_TWO = reason_of(MATERIALS, "pretrained", "one flash photo"), some_hold_photos_alone()
SEVERAL = reason_of(MATERIALS, "several", "several photos")
WORDS = {"few": FEW, "anisotropic": PHI_H, "pretrained": "one flash photo"}
OTHER_COMMANDS = "and recipes for these differ; fit them by two commands, or all by --recipe "

CASES = [
    # BRDFs: measurements that depend on phi_h, few ones, others
    Case("brdf"),
    Case("brdf", "brushed.csv", recipe="anisotropic", reasons=(reason_of("brdf", "anisotropic", PHI_H),)),
    Case("brdf", "brushed.csv", {"paradigm": "overfit"}, "anisotropic", "", (reason_of("brdf", "anisotropic", PHI_H),)),
    Case("brdf", "brushed.csv", {"paradigm": "general"}),
    Case("brdf", "brushed.csv", {"paradigm": "finetune"}),
    Case("brdf", "brushed.csv", {"paradigm": "quickft"}),
    Case("brdf", "brushed.csv", {"recipe": "full"}),
    Case("brdf", "brushed150.csv", recipe="anisotropic", reasons=(reason_of("brdf", "anisotropic", PHI_H),)),
    Case("brdf", "satin.bsdf brushed.csv", recipe="anisotropic", reasons=(reason_of("brdf", "anisotropic", PHI_H),)),
    Case("brdf", "flat.bsdf"),
    Case("brdf", "plain.csv"),
    Case("brdf", "gold.binary plain.csv"),
    Case("brdf", "paint.csv", recipe="few", reasons=(reason_of("brdf", "few", FEW),)),
    Case("brdf", "paint.csv", {"quiet": True}, recipe="few"),
    Case("brdf", "paint.csv", {"paradigm": "overfit"}),
    Case("brdf", "paint.csv", {"recipe": "paper"}, recipe="paper"),
    Case("brdf", "fews", recipe="few", reasons=(reason_of("brdf", "few", FEW),)),
    Case("brdf", "some", reasons=(f"brdf: recipe full, since 1 of 2 inputs have {FEW}",)),
    Case("brdf", "turned", {}, "anisotropic", reasons=(f"brdf: recipe anisotropic, since 1 of 2 inputs have {PHI_H}",)),
    Case("brdf", "turned", {"recipe": "anisotropic"}, "anisotropic"),
    Case("brdf", "paint.csv plain.csv", mistake=f"brdf: paint.csv has {FEW}, plain.csv has not, {OTHER_COMMANDS}few "),
    Case("brdf", "gold.binary paint.csv", mistake=f"brdf: paint.csv has {FEW}, gold.binary has not, {OTHER_COMMANDS}"),
    Case("brdf", "plain.csv brushed.csv", mistake=f"brdf: brushed.csv has {PHI_H}, plain.csv has not, "),
    Case("brdf", "paint.csv brushed.csv", mistake=f"brdf: brushed.csv has {PHI_H}, paint.csv has not, "),
    Case("brdf", "plain.csv brushed.csv", {"recipe": "anisotropic"}, "anisotropic"),
    Case("brdf", "plain.csv brushed.csv", {"paradigm": "general"}),
    Case("brdf", options={"data": "isotropic"}),
    Case("brdf", options={"data": "anisotropic"}, recipe="anisotropic",
         reasons=(reason_of("brdf", "anisotropic", PHI_H, "task of anisotropic"),)),
    Case("brdf", "plain.csv", {"data": "anisotropic"}),
    # applications of one kind of input
    Case("texture", "wall.png"),
    Case("texture", "photos wall.png", {"recipe": "quick"}, "quick"),
    Case("svbrdf_stationary", "photos"),
    Case("svbrdf_stationary", "wall.png", {"recipe": "paper-64"}, "paper-64"),
    Case("transport", "box.xml"),
    Case("transport"),
    # maps and flash photographs, one or several of a place
    Case(MATERIALS, protocol="reference"),
    Case(MATERIALS, "rock", protocol="reference"),
    Case(MATERIALS, "strip.png rock", protocol="reference"),
    Case(MATERIALS, "wall.png", {}, "pretrained", "photo", (ONE_PHOTO,)),
    Case(MATERIALS, "photos", {"paradigm": "general"}, "pretrained", "photo", (ONE_PHOTO,)),
    Case(MATERIALS, "wall.png", {"paradigm": "overfit"}, "full", "photo"),
    Case(MATERIALS, "wall.png", {"quiet": True}, "pretrained", "photo"),
    Case(MATERIALS, "wall.png", {"lacking": True}, "full", "photo", (f"{MATERIALS}: {LACKING}",)),
    Case(MATERIALS, "wall.png", {"lacking": True, "quiet": True}, "full", "photo", (f"{MATERIALS}: {LACKING}",)),
    Case(MATERIALS, "wall.png", {"recipe": "full"}, "full", "photo"),
    Case(MATERIALS, "wall.png", {"observe": "photo"}, "pretrained", "photo", (ONE_PHOTO,)),
    Case(MATERIALS, "wall.png", {"observe": "photo", "recipe": "quick"}, "quick", "photo"),
    Case(MATERIALS, "wall.png", {"observe": "reference"}, "full", "reference"),
    Case(MATERIALS, "strip.png", {"observe": "photo"}, "pretrained", "photo", (ONE_PHOTO,)),
    Case(MATERIALS, "rock wall.png", {}, "pretrained", "photo", (ONE_OF_TWO, ONE_PHOTO)),
    Case(MATERIALS, "mixed", {}, "pretrained", "photo", (ONE_OF_TWO, ONE_PHOTO)),
    Case(MATERIALS, "leaf", {}, "several", "photo", (SEVERAL,)),
    Case(MATERIALS, "leaf", {"paradigm": "overfit"}, "several", "photo", (SEVERAL,)),
    Case(MATERIALS, "leaf", {"lacking": True}, "several", "photo", (SEVERAL,)),
    Case(MATERIALS, "leaf/a.png", {}, "pretrained", "photo", (ONE_PHOTO,)),
    Case(MATERIALS, "leaf wall.png", {}, mistake=f"{MATERIALS}: wall.png has one flash photo, leaf has not, "),
    Case(MATERIALS, "leaves", {}, mistake=f"{MATERIALS}: leaves/wall.png has one flash photo, leaves/leaf has not, "),
    Case(MATERIALS, "leaf wall.png", {"lacking": True}, mistake=f"{MATERIALS}: wall.png has one flash photo, leaf "),
    Case(MATERIALS, "leaf wall.png", {"recipe": "several"}, "several", "photo"),
    Case(MATERIALS, "leaf wall.png", {"observe": "reference"}, "full", "reference"),
    Case(MATERIALS, "wall.png", {"observe": "reference", "recipe": "pretrained"}, mistake="--recipe 'pretrained': exp"),
    Case(MATERIALS, "", {"data": "maps"}, "full", "reference"),
    Case(MATERIALS, "", {"data": "maps", "observe": "photo"}, "pretrained", "photo",
         (reason_of(MATERIALS, "pretrained", "one flash photo", "task of maps"),)),
    Case(MATERIALS, "", {"data": "shots"}, "pretrained", "photo",
         (reason_of(MATERIALS, "pretrained", "one flash photo", "task of shots"),)),
    Case(MATERIALS, "", {"data": "places"}, "several", "photo",
         (reason_of(MATERIALS, "several", "several photos", "task of places"),)),
    # environment maps, and photographs of balls
    Case(BALLS, protocol="reference"),
    Case(BALLS, "sky.exr", {}, "full", "reference"),
    Case(BALLS, "wall.png", {}, "full", "photo"),
    Case(BALLS, "photos", {"shutter": "auto"}, "full", "photo"),
    Case(BALLS, "sky.exr wall.png", {}, "full", "photo", (some_hold_photos_alone(BALLS),)),
    Case(BALLS, "wall.png", {"observe": "reference"}, "full", "reference"),
    Case(BALLS, "sky.exr", {"recipe": "paper"}, "paper", "reference"),
]  # fmt: skip


def name_of(case: Case) -> str:
    words = [f"{key}={value}" for key, value in case.options.items()]
    return " ".join(filter(None, (case.app, case.inputs, *words)))


class Heard(Reporter):
    """Keeps what is said."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def say(self, message: str) -> None:
        self.lines.append(message)


def chosen(app: str, paths: Sequence[Path], **options: Any) -> tuple[str, str, tuple[str, ...]]:
    """Recipe, protocol and the lines that are said of inputs that are paths, or of a data set."""
    with use_reporter(heard := Heard()):
        choice = find_and_choose(fit_options(app, options.pop("paradigm", "meta"), paths, **options))
    return choice.options.recipe, choice.app.observes, tuple(heard.lines)


@pytest.mark.parametrize("case", CASES, ids=name_of)
def test_inputs_and_options_choose_recipe_and_protocol(
    case: Case, inputs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    options = dict(case.options)
    line = LACKING if options.pop("lacking", False) else ""
    monkeypatch.setattr("metapp.apps.svbrdf_nonstationary.pretrained.encoder.describe_missing_weights", lambda: line)
    monkeypatch.chdir(inputs)
    paths = [Path(name) for name in case.inputs.split()]
    if case.mistake:
        with pytest.raises(BadOption, match=re.escape(case.mistake)):
            chosen(case.app, paths, **options)
    else:
        assert chosen(case.app, paths, **options) == (case.recipe, case.protocol, case.reasons)


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
    choice = find_and_choose(fit_options(app, "general", [inputs / folder], quiet=True))
    assert find_inputs(choice)[0]
    assert listed.count(str(inputs / folder)) == 1


def test_files_that_come_later_are_found_by_the_next_command(tmp_path: Path) -> None:
    for seed in (1, 2):
        picture(tmp_path / f"{seed}.png", seed)
        assert len(find_and_choose(fit_options("texture", "general", [tmp_path])).sources) == seed


def tasks_of(app: str, *objects: Any) -> list[Task]:
    entry = registry().applications[app].read_object
    assert entry is not None
    return [entry.load()(source, f"object{number}") for number, source in enumerate(objects)]


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
    "maps and a photo": (MATERIALS, lambda: [MAPS, PIXELS], "pretrained", "photo"),
    "a map": (BALLS, lambda: [np.random.default_rng(0).random((32, 64, 3)).astype(np.float32)], "full", "reference"),
}  # fmt: skip


@pytest.mark.usefixtures("small_spheres")
@pytest.mark.parametrize("name", OBJECTS)
def test_objects_in_memory_choose_recipe_and_protocol(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("metapp.apps.svbrdf_nonstationary.pretrained.encoder.describe_missing_weights", lambda: "")
    app, objects, recipe, protocol = OBJECTS[name]
    result = objects()
    sources = [source_of_tensors(application(app), task.name, task.data) for task in tasks_of(app, *result)]
    choice = choose_recipe(fit_options(app, "meta", result), sources)
    assert (choice.name, choice.observes) == (recipe, protocol)
    reasons = [reason_of(app, recipe, WORDS[recipe])] if recipe in WORDS else []
    observation_reasons = [line for line in choice.reasons if "fits see" in line]
    assert len(observation_reasons) == (name == "maps and a photo")
    assert list(choice.reasons) == [*observation_reasons, *reasons]


def test_objects_that_no_recipe_suits_together_are_refused() -> None:
    sources = [
        source_of_tensors(application("brdf"), task.name, task.data) for task in tasks_of("brdf", pairs(20), pairs(500))
    ]
    line = f"brdf: object0 has {FEW}, object1 has not, {OTHER_COMMANDS}few or --recipe full."
    with pytest.raises(BadOption, match=re.escape(line)):
        choose_recipe(fit_options("brdf", "meta", [0, 1]), sources)
    assert choose_recipe(fit_options("brdf", "meta", [0, 1], recipe="full"), sources).name == "full"
