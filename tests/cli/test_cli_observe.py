"""What --observe picks is part of every figure and start, but of General, which all protocols share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from metapp.apps.svbrdf_nonstationary.app import SvbrdfNonstationary, field_of
from metapp.apps.svbrdf_nonstationary.recipes import RECIPES
from metapp.cli.evaluate import Evaluation, subjects_of
from metapp.evaluation.tables.results import closing
from metapp.storage.checkpoints import load_checkpoint
from tests.quick import app_by

SVBRDF = "svbrdf_nonstationary"
STEPS = ("--train", "--train-steps", "2", "--quiet")


@pytest.fixture
def on_data(metapp: Callable, short_by_protocol: Callable) -> Callable:
    """A command on ten small materials, eight of them for training, with small networks and a few steps."""
    field = field_of(16, hidden=8)._replace(code=3)
    short_by_protocol(RECIPES, SvbrdfNonstationary(field, encoder_width=2), SvbrdfNonstationary(field, encoder_width=2))
    assert metapp("data", "synth", SVBRDF, "--count", "10", "--size", "32", "--out", "set", "--quiet").code == 0
    return lambda command, *more: metapp(command, SVBRDF, *more, "--recipe", "quick", "--data", "set")


def test_protocols_share_general_and_nothing_else(on_data: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("metapp.paradigms.training.SEARCHED", ([{"rate": 0.5}],))
    rule = RECIPES["photo"]["quick"].rule
    for paradigm in ("meta", "quickft"):
        assert on_data(paradigm, "--observe", "photo", *STEPS).code == 0
    (folder,) = Path("runs", SVBRDF, "checkpoints").iterdir()
    assert {file.stem for file in folder.iterdir()} == {"general", f"{rule}-photo", "quickft-photo"}
    general = folder / "general.safetensors"
    assert load_checkpoint(folder / f"{rule}-photo.safetensors")[1]["observe"] == "photo"
    assert "observe" not in load_checkpoint(general)[1]
    before = load_checkpoint(general)[0].encoder
    assert on_data("general", *STEPS).code == 0
    assert all(torch.equal(value, before[key]) for key, value in load_checkpoint(general)[0].encoder.items())
    refused = on_data("meta", "--rule", rule, "--checkpoint", folder / f"{rule}-photo.safetensors").refusal
    assert "for --observe photo, expected one for reference" in refused
    assert "tuned Adam" in on_data("quickft", "--observe", "photo", "--checkpoint", folder).err
    other = on_data("quickft", "--checkpoint", folder).err
    assert f"metapp quickft {SVBRDF} --train --observe reference --data" in other


def test_a_protocol_that_nothing_named_has_is_refused(metapp: Callable) -> None:
    for apps, observe, reason in (
        (("texture", "svbrdf_stationary"), "photo", "texture has one protocol"),
        (("texture", SVBRDF), "mirror", f"{SVBRDF} expects one of reference, photo"),
    ):
        assert reason in metapp("evaluate", *apps, "--observe", observe, "--no-run").misuse


def test_the_option_reaches_those_that_have_the_protocol() -> None:
    """The first protocol is the default, where fits see what the paper's do; the whole evaluation has all."""
    both = [(SVBRDF, "reference"), (SVBRDF, "photo")]
    for more, expected in (({"observe": "photo"}, both[1:]), ({}, both[:1]), ({"whole": True}, both)):
        subjects = subjects_of(Evaluation(recipe="quick", no_run=True, **more), ["texture", SVBRDF])
        found = [(subject.app.name, subject.app.protocol) for subject in subjects]
        assert found == [("texture", ""), *expected]


def test_meta_is_compared_where_overfit_is_no_floor() -> None:
    errors = {"general": 1.0, "overfit": 0.5, "quickft": 0.978, "meta": 0.88}
    rows = [
        {"paradigm": name, "error": error, "shared_error": error, "few": False, "seconds": 1.0}
        | {"paper_error": None, "paper_seconds": None}
        for name, error in errors.items()
    ]
    assert "gap closed 0.24" in closing(app_by(SVBRDF), rows)
    said = closing(app_by(SVBRDF, protocol="photo"), rows)
    assert said.startswith("Meta's error is 12 % below General's, 10 % below QuickFT's; Overfit sees the photo alone")
    assert "gap" not in said
