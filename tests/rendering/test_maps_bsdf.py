"""The BSDF of maps in Mitsuba: what it reflects is what we fit, and it draws directions as densely as it says."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from metapp.appearance.flash import Maps, brdf
from tests.needs_mitsuba import needs_mitsuba

pytestmark = needs_mitsuba
ANGLES = (0, 30, 50, 70, 85)
MATERIALS = {
    "plaster": ((0.7, 0.6, 0.5), (0.04, 0.04, 0.04), 0.8),
    "gold": ((0.02, 0.01, 0.0), (1.0, 0.77, 0.34), 0.3),
    "odd": ((0.1, 0.4, 0.6), (0.6, 0.05, 0.3), 0.35),
    "glossy": ((0.1, 0.4, 0.6), (0.6, 0.05, 0.3), 0.12),
}


@pytest.fixture(scope="module")
def mi() -> Any:
    from metapp.rendering.variant import load_mitsuba

    module = load_mitsuba()
    from metapp.rendering.maps_bsdf import register_maps_bsdf

    register_maps_bsdf()
    return module


def described(name: str) -> dict[str, Any]:
    diffuse, specular, roughness = MATERIALS[name]
    return {
        "type": "neural_svbrdf",
        "diffuse": {"type": "rgb", "value": list(diffuse)},
        "specular": {"type": "rgb", "value": list(specular)},
        "roughness": roughness,
    }


def directions(count: int) -> Tensor:
    """Unit vectors [count, 3] above the horizon, evenly spread."""
    z, turn = torch.rand(2, count, generator=torch.Generator().manual_seed(3))
    return torch.stack([(1 - z * z).sqrt() * (6.2832 * turn).cos(), (1 - z * z).sqrt() * (6.2832 * turn).sin(), z], 1)


def interaction(mi: Any, wi: Any) -> Any:
    import drjit as dr

    si = dr.zeros(mi.SurfaceInteraction3f, len(wi))
    si.wi = mi.Vector3f(*(mi.Float(column) for column in np.float32(wi).T))
    si.t = 1.0
    return si


def vector(mi: Any, wo: Tensor) -> Any:
    return mi.Vector3f(*(mi.Float(column) for column in np.float32(wo).T))


@pytest.mark.parametrize("name", MATERIALS)
def test_it_reflects_what_is_fitted(mi: Any, name: str) -> None:
    wi, wo = directions(4096).split(2048)
    maps = [torch.tensor(each).double().reshape(-1, 1, 1) for each in (*MATERIALS[name], (0, 0, 1))]
    expected = brdf(Maps(*maps), wo.double().T[:, None], wi.double().T[:, None])[:, 0] * wo[:, 2]
    found = mi.load_dict(described(name)).eval(mi.BSDFContext(), interaction(mi, wi), vector(mi, wo))
    # single precision: at the peak of a narrow lobe the half vector's rounding counts
    torch.testing.assert_close(torch.from_numpy(np.array(found)), expected.float(), rtol=5e-4, atol=1e-5)


@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize("name", ["plaster", "gold", "odd"])  # the test's grid is too coarse for a narrower lobe
def test_directions_are_drawn_as_densely_as_it_says(mi: Any, name: str, angle: float) -> None:
    wi = [math.sin(math.radians(angle)), 0.0, math.cos(math.radians(angle))]
    plugin = {key: value for key, value in described(name).items() if key != "type"}
    sample, pdf = mi.chi2.BSDFAdapter("neural_svbrdf", xml_of(plugin), wi=wi)
    test = mi.chi2.ChiSquareTest(
        domain=mi.chi2.SphericalDomain(), sample_func=sample, pdf_func=pdf, sample_dim=3, res=101, ires=16
    )
    assert test.run()


def xml_of(plugin: dict[str, Any]) -> str:
    colours = (
        f'<rgb name="{key}" value="{" ".join(map(str, plugin[key]["value"]))}"/>' for key in ("diffuse", "specular")
    )
    return "".join(colours) + f'<float name="roughness" value="{plugin["roughness"]}"/>'


@pytest.mark.parametrize("name", MATERIALS)
def test_a_sample_weighs_its_value_over_its_density(mi: Any, name: str) -> None:
    bsdf, context, si = mi.load_dict(described(name)), mi.BSDFContext(), interaction(mi, directions(2000))
    one, two = np.random.default_rng(0).random((2, 2000), np.float32), np.random.default_rng(1).random(2000, np.float32)
    drawn, weight = bsdf.sample(context, si, mi.Float(two), mi.Point2f(*(mi.Float(each) for each in one)))
    value, density = bsdf.eval_pdf(context, si, drawn.wo)
    assert np.array_equal(np.array(density), np.array(drawn.pdf))
    above = np.array(drawn.wo)[2] > 0
    assert above.mean() > 0.8
    product = np.array(weight) * np.array(density)
    assert np.allclose(product[:, above], np.array(value)[:, above], rtol=1e-4, atol=1e-7)
    assert not np.array(weight)[:, ~above].any()


def test_components_add_up(mi: Any) -> None:
    bsdf = mi.load_dict(described("odd"))
    wi, wo = directions(512).split(256)
    si, light = interaction(mi, wi), vector(mi, wo)
    parts = []
    for component in (0, 1):
        context = mi.BSDFContext()
        context.component = component
        parts.append(np.array(bsdf.eval(context, si, light)))
    assert np.allclose(sum(parts), np.array(bsdf.eval(mi.BSDFContext(), si, light)), rtol=1e-5)


@pytest.mark.parametrize("name", MATERIALS)
def test_under_a_white_sky_no_more_than_all_comes_back(mi: Any, name: str) -> None:
    count = 200_000
    up = torch.tensor([[0.0, 0.0, 1.0]]).expand(count, -1)
    rng = np.random.default_rng(0)
    numbers = [mi.Float(rng.random(count, np.float32)) for _ in range(3)]
    _, weight = mi.load_dict(described(name)).sample(
        mi.BSDFContext(), interaction(mi, up), numbers[0], mi.Point2f(*numbers[1:])
    )
    mean = np.array(weight).mean(1)
    diffuse, specular, _ = (np.array(each) for each in MATERIALS[name])
    assert (mean < 1.005).all()
    assert (mean > 0.8 * (diffuse * (1 - specular) + specular)).all()


def test_maps_have_gradients(mi: Any) -> None:
    import drjit as dr

    bsdf = mi.load_dict(described("odd"))
    wi, wo = directions(64).split(32)
    si, light = interaction(mi, wi), vector(mi, wo)
    params = mi.traverse(bsdf)
    key = "roughness.value"

    def total() -> Any:
        return dr.sum(dr.mean(bsdf.eval(mi.BSDFContext(), si, light)))

    dr.enable_grad(params[key])
    params.update()
    dr.backward(total())
    slope = float(dr.grad(params[key])[0])
    values = []
    for step in (-1e-3, 1e-3):
        params[key] = mi.Float(0.35 + step)
        params.update()
        values.append(float(total()[0]))
    assert slope == pytest.approx((values[1] - values[0]) / 2e-3, rel=2e-2)
