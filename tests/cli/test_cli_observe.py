"""An application whose fits may see a reference or a photo: what --observe picks is part of every figure and start."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
import pytest
import torch
from torch import Generator, Tensor

from data_tools.readers.latlong import read_map
from metapp import door
from metapp.appearance.colour import tone_map
from metapp.appearance.presentation import Picture
from metapp.apps.brdf import recipes
from metapp.apps.brdf.app import Brdf
from metapp.apps.brdf.presentation import BrdfPresentation
from metapp.cli.evaluate import Evaluation, subjects_of
from metapp.evaluation.tables.results import closing
from metapp.learning.recipe import Recipe
from metapp.learning.task import Batch, Params, Task, Tasks
from metapp.runs.checkpoints.finding import checkpoint_name
from metapp.runs.checkpoints.shipped import shipped_path
from metapp.storage.records import load_checkpoint, read_records
from tests.quick import app_by

STEPS = ("--train", "--train-steps", "2", "--quiet")
pytestmark = pytest.mark.usefixtures("small_spheres")


class Seen(Brdf):
    """BRDFs of which a photo shows half the light; materials called `unknown...` have no reference."""

    def loss(self, theta: Params, batch: Batch, learned: Params) -> Tensor:
        seen = {"reference": 1.0, "photo": 0.5}[self.protocol]
        return super().loss(theta, batch | {"target": seen * batch["target"]}, learned)

    def outer_loss(self, theta: Params, batch: Batch, learned: Params) -> Tensor:
        return super().loss(theta, batch, learned)

    def errors(self, theta: Params, tasks: Tasks) -> dict[str, Tensor]:
        return {} if tasks.picked_names[0].startswith("unknown") else super().errors(theta, tasks)


class Shown(BrdfPresentation):
    """Their spheres, of unknown materials without a reference, and two files."""

    brightest = 3.0

    def outputs(self, theta: Params, task: Task) -> dict[str, Any]:
        pictures = super().outputs(theta, task)
        return {"fit": pictures["fit"]} if task.name.startswith("unknown") else pictures

    def files(self, theta: Params, task: Task) -> dict[str, Picture]:
        return {
            "light": Picture(light(self.brightest), "radiance"),
            "normal": Picture(torch.full((4, 4, 3), 0.5), "data"),
        }


def light(brightest: float) -> Tensor:
    return torch.linspace(0.1, brightest, 64 * 128 * 3).reshape(64, 128, 3)


TABLE: dict[str, Recipe] = {}


@pytest.fixture(autouse=True)
def seen(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """In place of BRDFs, with few steps of everything and without a compiler."""
    quick = recipes.RECIPES["quick"]
    short = {"meta-sgd": replace(quick.meta["meta-sgd"], order=1)}
    quick = replace(quick, steps=2, overfit_steps=3, finetune_steps=3, meta=short, rule="meta-sgd")
    for name, recipe in {**recipes.RECIPES, "quick": quick, "full": quick}.items():
        monkeypatch.setitem(TABLE, name, recipe)
    monkeypatch.setattr("metapp.extensions.native.fastest.can_compile", lambda: False)
    protocols = ("reference", "photo")
    application = door.Application("brdf", f"{__name__}:Seen", f"{__name__}:Shown", protocols)
    offers = [
        door.Recipe("brdf", name, f"{__name__}:TABLE.{name}", protocol)
        for name in ("quick", "full", "paper")
        for protocol in protocols
    ]
    with door.extended("seen", [application, *offers]):
        yield


@pytest.fixture
def networks(neural_fits: Callable[[int], Path]) -> Path:
    """m0, m1, and one of which there is no reference."""
    folder = neural_fits(3)
    (folder / "m2").rename(folder / "unknown")
    return folder


@pytest.fixture
def on_data(metapp: Callable, ten_materials: Path) -> Callable:
    """A command on ten small materials, eight of them for training, runs in a folder of this test."""
    return lambda *arguments: metapp(*arguments, "--recipe", "quick", "--data", ten_materials)


# Fits


def test_a_fit_says_what_it_saw(on_data: Callable) -> None:
    documents = {}
    for observe in ("", "reference", "photo"):
        result = on_data("overfit", "brdf", *(("--observe", observe) if observe else ()), "--json")
        assert f"brdf {observe or 'reference'} overfit: 2 inputs" in result.err
        documents[observe] = result.document
    assert [document["observe"] for document in documents.values()] == ["reference", "reference", "photo"]
    assert documents[""]["tasks"][0]["error"] == documents["reference"]["tasks"][0]["error"]
    assert documents[""]["error"] != documents["photo"]["error"]
    folders = {observe: Path(document["out"]) for observe, document in documents.items()}
    assert folders[""] == folders["reference"]
    assert folders["photo"].name == folders[""].name.replace("-reference", "-photo")
    (record, _) = read_records(folders["photo"] / "record.jsonl")
    assert record["settings"]["observe"] == "photo"
    assert "fits see: photo" in " ".join(on_data("overfit", "brdf", "--observe", "photo").out.split())


def test_an_application_with_one_protocol_says_nothing(on_data: Callable) -> None:
    offers = [door.Recipe("brdf", name, f"{__name__}:TABLE.{name}") for name in ("quick", "full", "paper")]
    application = door.Application("brdf", "metapp.apps.brdf.app:Brdf", f"{__name__}:Shown")
    with door.extended("one", [application, *offers]):
        document = on_data("overfit", "brdf", "--json").document
        assert "has one protocol" in on_data("evaluate", "brdf", "--observe", "photo").misuse
    assert "observe" not in document
    assert document["out"].endswith("-seed0")
    assert "observe" not in read_records(Path(document["out"]) / "record.jsonl")[0]["settings"]


# Checkpoints


def test_protocols_share_general_and_nothing_else(on_data: Callable) -> None:
    assert on_data("meta", "brdf", "--observe", "photo", *STEPS).code == 0
    (folder,) = Path("runs/brdf/checkpoints").iterdir()
    assert {file.stem for file in folder.iterdir()} == {"general", "meta-sgd-photo"}
    general = folder / "general.safetensors"
    assert load_checkpoint(folder / "meta-sgd-photo.safetensors")[1]["observe"] == "photo"
    assert "observe" not in load_checkpoint(general)[1]
    refused = on_data("meta", "brdf", "--checkpoint", folder / "meta-sgd-photo.safetensors").refusal
    parts = ("meta-sgd-photo", "for --observe photo", "expected one for reference", "give --observe photo")
    assert all(part in refused for part in parts), refused
    for observe in ("reference", "photo"):
        assert on_data("general", "brdf", "--checkpoint", general, "--observe", observe).code == 0
    before = load_checkpoint(general)[0].encoder
    assert on_data("general", "brdf", *STEPS).code == 0
    assert all(torch.equal(value, before[key]) for key, value in load_checkpoint(general)[0].encoder.items())

    assert on_data("meta", "brdf", *STEPS).code == 0
    assert load_checkpoint(folder / "meta-sgd.safetensors")[1]["observe"] == "reference"
    for observe, name in (("photo", "meta-sgd-photo.safetensors"), ("reference", "meta-sgd.safetensors")):
        assert name in on_data("meta", "brdf", "--observe", observe, "--checkpoint", folder).err


def test_quickft_is_tuned_per_protocol(on_data: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("metapp.paradigms.tuning.SEARCHED", ([{"rate": 0.5}],))
    assert on_data("quickft", "brdf", "--observe", "photo", *STEPS).code == 0
    (file,) = Path("runs").rglob("quickft*.safetensors")
    assert file.stem == "quickft-photo"
    assert load_checkpoint(file)[1]["observe"] == "photo"
    given = ("--checkpoint", file.parent)
    assert "tuned Adam" in on_data("quickft", "brdf", "--observe", "photo", *given).err
    assert "metapp quickft brdf --train --observe reference --data" in on_data("quickft", "brdf", *given).err


def test_only_the_first_protocol_takes_the_starts_without_a_name(on_data: Callable) -> None:
    for observe, suffix in (("reference", ""), ("photo", "-photo")):
        under = app_by("brdf", protocol=observe)
        assert checkpoint_name(under, "general") == "general"
        assert checkpoint_name(under, "meta-basis") == f"meta-basis{suffix}"
    assert shipped_path("brdf", checkpoint_name(app_by("brdf"), "general")).is_file()
    assert "the checkpoint that ships" in on_data("meta", "brdf").err
    missing = on_data("meta", "brdf", "--observe", "photo").error
    assert "brdf photo meta-sgd, recipe quick: no checkpoint" in missing


# Tables


def test_a_protocol_that_nothing_named_has_is_refused(metapp: Callable) -> None:
    for apps, observe, reason in (
        (("texture",), "photo", "texture has one protocol"),
        (("texture", "svbrdf_stationary"), "photo", "texture has one protocol"),
        (("texture", "brdf"), "mirror", "brdf expects one of reference, photo"),
    ):
        assert reason in metapp("evaluate", *apps, "--observe", observe, "--no-run").misuse


def test_the_option_reaches_those_that_have_the_protocol() -> None:
    """The first protocol is the default, where fits see what the paper's do; the whole evaluation has all."""
    both = [("brdf", "reference"), ("brdf", "photo")]
    for more, expected in (({"observe": "photo"}, both[1:]), ({}, both[:1]), ({"whole": True}, both)):
        options = Evaluation(["texture", "brdf"], recipe="quick", no_run=True, **more)
        found = [(subject.app.name, subject.app.protocol) for subject in subjects_of(options)]
        assert found == [("texture", ""), *expected]


def test_meta_is_compared_where_overfit_is_no_floor() -> None:
    errors = {"general": 1.0, "overfit": 0.5, "quickft": 0.978, "meta": 0.88}
    rows = [
        {"paradigm": name, "error": error, "shared_error": error, "few": False, "seconds": 1.0}
        | {"paper_error": None, "paper_seconds": None}
        for name, error in errors.items()
    ]
    assert "gap closed 0.24" in closing(app_by("brdf"), rows)
    photo = app_by("brdf", protocol="photo")
    said = closing(photo, rows)
    assert said.startswith("Meta's error is 12 % below General's, 10 % below QuickFT's; Overfit sees the photo alone")
    assert "gap" not in said
    rows[-1]["error"] = 1.1
    assert "10 % above General's" in closing(photo, rows)
    rows[-1]["error"] = None
    assert closing(photo, rows).startswith("Overfit sees the photo alone and is no floor")


# Tasks without a reference


def test_a_data_set_of_tasks_without_reference_has_a_table(metapp: Callable, networks: Path) -> None:
    made = metapp("data", "nbrdf", networks / "unknown", "--split", "test", "--out", "unknown", "--samples", "512")
    assert made.code == 0, made.err
    common = ("evaluate", "brdf", "--data", "unknown", "--observe", "reference")
    row = metapp(*common, "--json").done["rows"][0]
    assert (row["tasks"], row["error"], row["worst"], row["low"]) == (1, None, None, None)
    assert metapp(*common).code == 0


def test_parameters_that_are_not_finite_are_an_error(
    metapp: Callable, networks: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    init = Seen.init

    def infinite(self: Seen, rng: Generator, count: int) -> Params:
        return {key: value / 0 for key, value in init(self, rng, count).items()}

    monkeypatch.setattr(Seen, "init", infinite)
    for name in ("m1", "unknown"):
        error = metapp("overfit", "brdf", networks / name, "--steps", "0").error
        assert f"{name}: the fit's parameters are not finite" in error
    assert not list(Path("runs").rglob("*.jsonl"))


# Radiance


def test_radiance_is_kept_as_exr_and_shown_as_png(
    metapp: Callable, networks: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for brightest, form in ((1e-7, "float"), (3.0, "half"), (65504.0, "half"), (1e6, "float")):
        monkeypatch.setattr(Shown, "brightest", brightest)
        document = metapp("overfit", "brdf", networks / "m1", "--json", "--quiet", "--out", str(brightest)).done
        made, wanted = Path(document["out"]) / "outputs" / "m1", light(brightest)
        assert {file.name for file in made.iterdir()} == {"light.exr", "light.png", "normal.png"}
        spec = oiio.ImageBuf(str(made / "light.exr")).spec()
        assert (str(spec.format), spec.channelnames) == (form, ("R", "G", "B")), brightest
        assert "rec709" in spec.get_string_attribute("oiio:ColorSpace")
        stored = wanted.half().float() if form == "half" else wanted
        exr = read_map(made / "light.exr")
        torch.testing.assert_close(exr, stored.permute(2, 0, 1), rtol=1e-5, atol=1e-6 * brightest)
        shown = oiio.ImageBuf(str(made / "light.png")).get_pixels(oiio.UINT8)
        assert np.abs(shown - 255 * tone_map(wanted / wanted.mean()).numpy()).max() <= 0.51, brightest
