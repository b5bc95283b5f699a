"""Warnings about fits that collapsed to one value, and remarks about inputs that are one value."""

from dataclasses import replace

import torch
from torch import Tensor
from typing_extensions import override

from data_tools.readers.brdf_task import make_brdf_task
from metapp.appearance.svbrdf_maps import Maps
from metapp.apps.svbrdf_nonstationary.app import SvbrdfNonstationary
from metapp.apps.svbrdf_nonstationary.field_maps import FieldMaps
from metapp.learning.app import stack_tasks
from metapp.learning.task import Params, Task
from tests.recipe_apps import app_by_recipe, presenter_of


def test_a_network_of_zeros_is_black_where_the_material_is_not() -> None:
    app = app_by_recipe("brdf")
    presenter = presenter_of(app)
    theta = app.init(torch.Generator().manual_seed(0), 1)
    zeros = {key: torch.zeros_like(value) for key, value in theta.items()}
    gloss = make_brdf_task(
        "gloss", lambda angles: 0.1 + (-50 * angles[..., :1] ** 2).exp().expand(*angles.shape[:-1], 3), 64
    )
    black = make_brdf_task("black", lambda angles: torch.zeros(*angles.shape[:-1], 3), 64)
    chalk = make_brdf_task("chalk", lambda angles: torch.full((*angles.shape[:-1], 3), 0.3), 64)
    tasks = [gloss, black, chalk]
    single = {key: value[0] for key, value in zeros.items()}
    messages = [presenter.quality_warnings(zeros, stack_tasks(app, [task], "cpu"))[0] for task in tasks]
    assert [[clause.partition(",")[0] for clause in clauses] for clauses in messages] == [
        ["the fit is black"], [], ["the fit is black"]
    ]  # fmt: skip
    notes = [str(presenter.remarks(single, task).get("note", "")) for task in tasks]
    assert ["the input is one reflectance" in note for note in notes] == [False, False, True]


def app_with_fixed_maps(app: SvbrdfNonstationary, maps: Maps) -> SvbrdfNonstationary:
    """An application whose fits have these maps, whatever their parameters."""

    class FixedMaps(FieldMaps):
        @override
        def make_maps(self, theta: Params, photo: Tensor) -> Maps:
            return maps

    return replace(app, decoder=FixedMaps(app.decoder.network, app.decoder.camera_motion))


def test_black_maps_get_a_warning() -> None:
    app = app_by_recipe("svbrdf_nonstationary", observes="photo")
    theta = app.init(torch.Generator().manual_seed(0), 1)
    photo = torch.randint(40, 200, (3, 64, 64), dtype=torch.uint8)
    tasks = stack_tasks(app, [Task("stone", {"photo": photo})], "cpu")
    plane = torch.ones(1, 1, 8, 8)
    for albedo, is_black in (0.0, True), (0.01, False), (0.5, False):
        maps = Maps(albedo * plane.expand(1, 3, 8, 8), 0 * plane, plane, plane.expand(1, 3, 8, 8))
        (clauses,) = presenter_of(app_with_fixed_maps(app, maps)).quality_warnings(theta, tasks)
        assert any(clause.startswith("the fit is black") for clause in clauses) is is_black
