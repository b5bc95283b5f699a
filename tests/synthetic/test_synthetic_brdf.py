"""The synthetic materials: physical laws for every one of them, Mitsuba's own values for the models it shares."""

import math
from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

from data_tools.synthetic.brdf import colour_name, roughness_name, synthetic_materials
from data_tools.synthetic.brdf_draws import SyntheticBrdf
from data_tools.synthetic.brdf_models import CONDUCTORS, conductor, diffuse
from metapp.appearance.geometry import (
    angle_cosines,
    directions_to_rusinkiewicz,
    gauss_legendre,
    is_above_horizon,
    rusinkiewicz_to_directions,
)

RandomAngles = Callable[..., Tensor]
MitsubaBrdf = Callable[[dict[str, Any], Tensor, Tensor], Tensor]

SHIPPED = {"gold": "Au", "silver": "Ag", "copper": "Cu", "aluminium": "Al", "chromium": "Cr", "nickel": "Ni_palik"}
SHIPPED |= {"tungsten": "W", "titanium-nitride": "TiN", "vanadium-nitride": "VN", "tantalum": "Ta"}
SHIPPED |= {"copper-oxide": "CuO", "amorphous-carbon": "a-C", "rhodium": "Rh", "iridium": "Ir"}


@pytest.fixture(scope="module")
def materials() -> list[SyntheticBrdf]:
    return synthetic_materials("train") + synthetic_materials("test")


def test_sets_have_stated_counts_and_names_and_equal_draws(
    materials: list[SyntheticBrdf], random_angles: RandomAngles
) -> None:
    names = [material.name for material in materials]
    assert len(names) == len(set(names)) == 100
    assert all(name == name.lower() and " " not in name for name in names)
    again, angles = synthetic_materials("train", 10), random_angles(100)
    assert [material.name for material in again] == names[:10]
    for first, other in zip(again, materials, strict=False):
        assert torch.equal(first.evaluate(angles), other.evaluate(angles))
    assert {name.split("-")[0] for name in names[:80]} == {name.split("-")[0] for name in names[80:]}
    colours = {(0.8, 0.02, 0.02): "red", (0.02, 0.02, 0.8): "blue", (0.9,) * 3: "white", (0.01,) * 3: "black"}
    assert {rgb: colour_name(rgb) for rgb in colours} == colours
    assert [roughness_name(alpha) for alpha in (0.03, 0.1, 0.2, 0.5)] == ["polished", "satin", "brushed", "rough"]


def test_draws_are_the_same_on_every_machine(materials: list[SyntheticBrdf]) -> None:
    """Whoever changes a draw changes the default data set, and with it all checkpoints and tables."""
    angles = torch.tensor([0.05, 0.4, 1.0], dtype=torch.float64)
    for index, name, linear_rgb in (
        (0, "conductor-copper-oxide-polished-00", (2.58189, 1.76414, 1.63350)),
        (81, "plastic-magenta-brushed-t01", (0.172939, 0.161022, 0.170812)),
    ):
        assert materials[index].name == name
        found = materials[index].evaluate(angles)
        torch.testing.assert_close(found, torch.tensor(linear_rgb, dtype=torch.float64), rtol=1e-5, atol=0)
    grazing = torch.stack([angles, torch.tensor([0.8, 0.3, 2.0], dtype=torch.float64)])
    means = torch.stack([material.evaluate(grazing).log1p() for material in materials]).mean(0)
    expected = torch.tensor([[0.5173, 0.4796, 0.4629], [0.0361, 0.0336, 0.0330]], dtype=torch.float64)
    torch.testing.assert_close(means, expected, rtol=0, atol=6e-5)


def test_materials_are_reciprocal_non_negative_and_dark_below_the_horizon(
    materials: list[SyntheticBrdf], random_angles: RandomAngles
) -> None:
    angles = random_angles(2000, above=False)
    swapped = directions_to_rusinkiewicz(*reversed(rusinkiewicz_to_directions(angles)))
    other_half = angles + torch.tensor([0.0, 0.0, math.pi], dtype=torch.float64)  # swapped, but not folded back
    above = is_above_horizon(angles)
    for material in materials:
        value = material.evaluate(angles)
        assert value.shape == angles.shape
        assert value.isfinite().all(), material.name
        assert (value >= 0).all(), material.name
        assert (value[~above] == 0).all(), material.name
        torch.testing.assert_close(material.evaluate(swapped), value, rtol=1e-6, atol=1e-9, msg=material.name)
        torch.testing.assert_close(material.evaluate(other_half), value, rtol=1e-6, atol=1e-9, msg=material.name)


def test_no_material_reflects_more_than_it_receives(materials: list[SyntheticBrdf]) -> None:
    # Half vectors on rings, dense towards the normal: right for lobes of any width.
    nodes, weights = gauss_legendre(40)
    reach = math.asinh(math.pi / 2 / 0.03)
    theta = (0.03 * (nodes * reach).sinh())[:, None]
    phi = (torch.arange(24, dtype=torch.float64) + 0.5) * math.pi / 24
    solid_angle = weights[:, None] * 0.03 * reach * (nodes[:, None] * reach).cosh() * theta.sin() * math.tau / 24
    half = torch.stack([theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos().expand(-1, 24)], dim=-1)
    incident = torch.tensor([0.15, 0.4, 0.7, 1.0], dtype=torch.float64)
    wi = torch.stack([(1 - incident**2).sqrt(), 0 * incident, incident], dim=-1)[:, None, None]
    cos_d = (wi * half).sum(-1, keepdim=True)
    wo = 2 * cos_d * half - wi
    angles = directions_to_rusinkiewicz(wi.expand_as(wo), wo)
    measure = (4 * cos_d.clamp_min(0) * wo[..., 2:].clamp_min(0)) * solid_angle[..., None]
    unit = (diffuse((1.0, 1.0, 1.0))(angle_cosines(angles)) * measure).sum((1, 2))
    torch.testing.assert_close(unit, torch.ones_like(unit), rtol=0, atol=0.02)  # the quadrature itself
    albedos = torch.stack([(material.evaluate(angles) * measure).sum((1, 2)) for material in materials])
    assert albedos.max() <= 1.02
    assert albedos.amax((1, 2)).min() > 0.01  # none is a black hole
    assert albedos[:, 2].mean(-1).quantile(0.9) - albedos[:, 2].mean(-1).quantile(0.1) > 0.3  # dark and bright ones


@pytest.mark.parametrize("metal", SHIPPED)
def test_metals_agree_with_mitsubas_presets(mitsuba_brdf: MitsubaBrdf, metal: str, random_angles: RandomAngles) -> None:
    angles = random_angles(200)
    preset = {"type": "roughconductor", "material": SHIPPED[metal], "alpha": 0.2, "distribution": "ggx"}
    value = conductor(*CONDUCTORS[metal], 0.2, "ggx")(angle_cosines(angles))
    torch.testing.assert_close(value, mitsuba_brdf(preset, *rusinkiewicz_to_directions(angles)), rtol=1e-4, atol=1e-6)
