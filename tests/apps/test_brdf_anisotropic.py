"""Anisotropic BRDFs: inputs that are read, networks that are fitted, and uses that are refused."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from data_tools.readers.brdf_objects import task_of_object
from data_tools.readers.brdf_task import depends_on_phi_h, make_brdf_task
from data_tools.readers.measured_pairs import task_of_pairs
from data_tools.synthetic.brdf import synthetic_materials
from data_tools.synthetic.brdf_anisotropic import TEST_ONLY_FAMILIES, anisotropic_materials
from data_tools.synthetic.brdf_anisotropic_models import anisotropic_directional_albedo
from metapp.appearance.geometry import (
    directions_to_four_angles,
    directions_to_full_rusinkiewicz,
    half_difference_vectors,
    rotate_about_normal,
    rusinkiewicz_to_directions,
)
from metapp.apps.brdf.anisotropic import anisotropic_inputs, find_axes
from metapp.apps.brdf.app import Brdf
from metapp.learning.app import stack_tasks
from metapp.learning.task import Task
from tests import anisotropic
from tests.anisotropic import (
    APP,
    HIGHLIGHT_AZIMUTH_RAD,
    brushed_reflectance,
    brushed_reflectance_at_angles,
    measure_with_noise,
    random_directions,
)

pytestmark = pytest.mark.usefixtures("small_spheres")


def test_four_angles_give_the_directions_back() -> None:
    wi, wo = random_directions(1000, 0), random_directions(1000, 1)
    angles = directions_to_four_angles(wi, wo)
    for found, expected in zip(rusinkiewicz_to_directions(angles), (wi, wo), strict=True):
        torch.testing.assert_close(found, expected, rtol=0, atol=1e-9)
    torch.testing.assert_close(angles[:, :3], directions_to_full_rusinkiewicz(wi, wo))
    total = wi + wo
    torch.testing.assert_close(half_difference_vectors(angles)[:, :3], total / total.norm(dim=1, keepdim=True))
    up = torch.tensor([[0.0, 0.0, 1.0]])
    assert directions_to_four_angles(up, up)[0, 3] == 0


def test_inputs_are_reciprocal_and_turn_with_the_material() -> None:
    wi, wo = random_directions(1000, 0), random_directions(1000, 1)
    where, exchanged = (
        APP.prepare(task_at(directions_to_four_angles(*pair)))["where"] for pair in ((wi, wo), (wo, wi))
    )
    turn, none = torch.full((1, 1), 0.4), torch.zeros(1, 1)
    first = anisotropic_inputs(where.T[None], none)
    torch.testing.assert_close(first, anisotropic_inputs(exchanged.T[None], none), rtol=1e-3, atol=1e-4)
    around = torch.cat([rotate_about_normal(where[:, :3], turn[0]), where[:, 3:]], 1).T[None]
    torch.testing.assert_close(first, anisotropic_inputs(around, turn), rtol=1e-3, atol=1e-4)
    assert float((first - anisotropic_inputs(around, none)).abs().max()) > 0.1


def task_at(angles: Tensor) -> Task:
    angles = angles.float()
    data = {"angles": angles[:, :3], "phi_h": angles[:, 3], "reflectance": brushed_reflectance_at_angles(angles)}
    return Task("brushed", data)


@pytest.mark.parametrize("seed", range(3))
def test_axes_are_found_in_samples(seed: int) -> None:
    batch = APP.sample(stack_tasks(APP, [anisotropic.brushed_task()]), torch.Generator().manual_seed(seed), 1024)
    assert float(find_axes(batch)) == pytest.approx(HIGHLIGHT_AZIMUTH_RAD, abs=0.05)


def test_a_fit_is_reciprocal_and_nearer_than_an_isotropic_one() -> None:
    theta, wi, wo = anisotropic.solve_for_brushed(), random_directions(2000, 0), random_directions(2000, 1)
    forward, back = (APP.reflectance(theta, directions_to_four_angles(*pair).float()) for pair in ((wi, wo), (wo, wi)))
    torch.testing.assert_close(forward, back, rtol=1e-3, atol=1e-4)
    assert forward.isfinite().all()
    with torch.no_grad():
        fit_albedo = anisotropic_directional_albedo(
            lambda *pair: APP.reflectance(theta, directions_to_four_angles(*pair).float()).double(), wi[:4], 24
        )
    assert fit_albedo.max() < 1
    tasks = stack_tasks(APP, [anisotropic.brushed_task()])
    error = float(APP.errors({key: value[None] for key, value in theta.items()}, tasks)["error"])
    where, target = tasks.data["where"][0], tasks.data["target"][0]
    # the mean over phi_h is about the best that is isotropic: what remains is how far samples are from it
    near = torch.cdist(where[:2000, [2, 3, 4, 5]], where[:2000, [2, 3, 4, 5]]).topk(20, largest=False).indices
    spread = float((target[:2000][near].median(1).values - target[:2000]).abs().mean())
    assert error < 0.6 * spread


def test_synthetic_materials_are_reciprocal_and_lose_energy() -> None:
    wi, wo = random_directions(200, 0), random_directions(200, 1)
    for material in anisotropic_materials("test", 7):

        def value(*pair: Tensor) -> Tensor:
            return material.evaluate(directions_to_four_angles(*pair))  # noqa: B023

        torch.testing.assert_close(value(wi, wo), value(wo, wi), rtol=1e-6, atol=1e-9)
        assert value(wi, wo).min() >= 0
        assert anisotropic_directional_albedo(value, wi[:3], 64).max() < 1.01
        assert depends_on_phi_h(material.evaluate)
    names = [
        {drawn_material.name.split("-")[0] for drawn_material in anisotropic_materials(split, 14)}
        for split in ("train", "test")
    ]
    assert names[1] - names[0] == set(TEST_ONLY_FAMILIES)
    assert not any(depends_on_phi_h(drawn_material.evaluate) for drawn_material in synthetic_materials("test", 8))


def test_dependence_on_phi_h_is_detected_in_functions() -> None:
    def function(wi: np.ndarray, wo: np.ndarray) -> Tensor:
        return brushed_reflectance(*(torch.from_numpy(vectors).double() for vectors in (wi, wo)))

    task = task_of_object(function, "f")
    assert task.data["phi_h"].shape == (65_536,)
    four = torch.cat([task.data["angles"], task.data["phi_h"][:, None]], 1)
    torch.testing.assert_close(task.data["reflectance"], brushed_reflectance_at_angles(four), rtol=1e-3, atol=1e-5)
    assert "phi_h" not in task_of_object(lambda wi, wo: 0.1 + 0 * wi, "lambert").data


@pytest.mark.parametrize("count", [500, 4000])
def test_measured_samples_keep_phi_h_where_it_counts(count: int) -> None:
    task = task_of_pairs("a", measure_with_noise(count))
    four = torch.cat([task.data["angles"], task.data["phi_h"][:, None]], 1)
    ratio = task.data["reflectance"] / brushed_reflectance_at_angles(four)
    assert float((ratio.log().std() - 0.05).abs()) < 0.01
    assert "phi_h" not in task_of_pairs("a", measure_with_noise(count, anisotropic=False)).data


def test_forms_without_phi_h_are_refused_in_one_line(metapp: Callable, tmp_path: Path) -> None:
    metapp("data", "synth", "brdf", "--anisotropic", "--count", 5, "--out", tmp_path / "set")
    metapp("meta", "brdf", "--data", tmp_path / "set", "--out", tmp_path / "runs", "--quiet")
    (run,) = (tmp_path / "runs" / "brdf").iterdir()
    for form, words in (("merl", "a MERL table has no phi_h"), ("nbrdf", "the NBRDF network has no phi_h")):
        refused = metapp("export", run, form)
        assert words in refused.error
        assert "export bsdf or mitsuba" in refused.error
    merl = metapp("data", "synth", "brdf", "--anisotropic", "--as", "merl", "--out", tmp_path / "merl")
    assert merl.code == 2
    assert metapp("data", "synth", "texture", "--anisotropic", "--out", tmp_path / "x").code == 1


def test_isotropic_tasks_are_fitted_at_random_azimuths() -> None:
    task = make_brdf_task("plain", lambda angles: 0.1 + 0 * angles[..., :3], 256)
    where = APP.prepare(task)["where"]
    assert float(where[:, 1].abs().max()) > 0.1
    torch.testing.assert_close(where[:, 6], Brdf().prepare(task)["where"][:, 6], rtol=0, atol=1e-5)
