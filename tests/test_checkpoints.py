"""The starts that ship: they load, belong together, and fit materials that they have not seen."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from torch import Generator

from data_tools.brdf_task import brdf_task
from data_tools.synthetic_brdf import synthetic_materials
from metapp.apps.brdf import APP
from metapp.cli.starts import shipped_path
from metapp.learning import MetaParameters
from metapp.paradigms import Job, paradigms
from metapp.records import load_start, tensor_digest
from metapp.task import Tasks, stack

SHIPPED = sorted(shipped_path("brdf", "general").parent.glob("*.safetensors"))


@pytest.fixture(scope="module")
def unseen() -> Tasks:
    materials = synthetic_materials("test")[:8]
    return stack(APP, [brdf_task(each.name, each.evaluate, samples=8192) for each in materials])


def error_of(paradigm: str, rule: str, prepared: MetaParameters, tasks: Tasks) -> float:
    job = Job(APP, APP.recipes["quick"], rule)
    theta = paradigms()[paradigm].fit(job, prepared, tasks, Generator().manual_seed(0))
    return APP.scale * float(APP.errors(theta, tasks)["error"].mean())


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_says_what_it_is(path: Path) -> None:
    _, info = load_start(path)
    assert (info["app"], info["start"]) == ("brdf", path.stem)
    assert info["validation_error"] > 0
    assert path.stat().st_size < 2e6
    if path.stem != "general":
        encoder, _ = load_start(shipped_path("brdf", "general"))
        assert info["encoder"] == tensor_digest(encoder.encoder)


def test_every_rule_of_the_quick_recipe_ships() -> None:
    assert {path.stem for path in SHIPPED} == {"general", "quickft", *APP.recipes["quick"].meta}


def test_ten_steps_of_the_default_rule_beat_the_other_quick_ways_on_unseen_materials(unseen: Tasks) -> None:
    starts = {path.stem: load_start(path)[0] for path in SHIPPED}
    tuned = starts["general"]._replace(alpha=starts["quickft"].alpha)
    rule = APP.recipes["quick"].rule
    meta = error_of("meta", rule, starts[rule], unseen)
    assert meta < 0.8
    assert meta < error_of("quickft", rule, tuned, unseen)
    assert meta < error_of("general", rule, starts["general"], unseen)


def test_the_command_finds_them(metapp: Callable, tmp_path: Path) -> None:
    data = tmp_path / "few"
    assert metapp("data", "synth", "brdf", "--count", "5", "--out", data).code == 0
    result = metapp("meta", "brdf", "--data", data, "--out", tmp_path, "--json")
    assert "the one that ships, trained on other data" in result.err
    assert result.document["error"] < 2
