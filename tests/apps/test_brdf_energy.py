"""How much light BRDFs reflect: closed forms, fits that reflect no more than they receive, unmeasured angles."""

import functools
import math

import numpy as np
import pytest
import torch
from torch import Generator, Tensor

import metapp
from metapp.appearance.geometry import angle_cosines, quasirandom_angles, rusinkiewicz_to_directions
from metapp.apps.brdf.app import Brdf
from metapp.apps.brdf.brdf_network import find_network
from metapp.apps.brdf.energy import albedo, conserve_energy, quadrature
from metapp.apps.brdf.highlight import MIRROR_DEGREES
from metapp.apps.brdf.nbrdf_network import NBRDF_NETWORK
from metapp.learning.task import Task
from tests.recipe_apps import presenter_of


def grey(value: Tensor) -> Tensor:
    return value[..., None].expand(*value.shape, 3)


def test_a_white_diffuse_surface_reflects_all() -> None:
    shares = albedo(lambda angles: grey(torch.full(angles.shape[:-1], 1 / math.pi)))
    torch.testing.assert_close(shares, torch.ones(16, 3, dtype=torch.float64), atol=1e-3, rtol=0)


@pytest.mark.parametrize("power", [400.0, 40_000.0])
def test_narrow_lobes_reflect_all(power: float) -> None:
    """Half vectors with the density cos^n theta_h (n + 1) / (2 pi), in normal light."""

    def lobe(angles: Tensor) -> Tensor:
        c = angle_cosines(angles.double())
        density = (power + 1) / (2 * math.pi) * c.half**power
        return grey(density / (4 * c.difference * torch.minimum(c.incident, c.outgoing).clamp_min(1e-6)))

    assert float(albedo(lobe)[0, 0]) == pytest.approx(1, abs=1e-3)


def test_energy_correction_changes_too_bright_materials_alone() -> None:
    """A diffuse layer that is twice as bright as white, and one below: with what rises towards grazing angles."""
    angles, _ = quadrature()
    c = angle_cosines(angles)
    steep = torch.minimum(c.incident, c.outgoing).arccos().flatten()
    features = torch.stack([torch.ones_like(steep), (steep / 1.5) ** 4, (steep / 1.5) ** 8])
    diffuse = math.log1p(0.9 / math.pi)
    dark = torch.tensor([[diffuse, 0.0, 0.0]] * 3)
    assert torch.equal(conserve_energy(features, dark), dark)
    rising = torch.tensor([[diffuse, 0.0, 2.0], [diffuse / 2, 0.0, 0.0], [0.1, 0.0, 0.0]])
    limited = conserve_energy(features, rising)

    def shares(layer: Tensor) -> Tensor:
        values = torch.expm1(layer.double() @ features).T.unflatten(0, angles.shape[:2])
        return albedo(lambda _: values)

    assert float(shares(rising).amax()) > 2
    assert 0.97 < float(shares(limited).amax()) <= 1


@pytest.fixture
def bright() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pairs of directions and a diffuse reflectance of 1.3 under a gloss."""
    angles = quasirandom_angles(4096).double()
    wi, wo = rusinkiewicz_to_directions(angles)
    values = 1.3 / math.pi + 0.5 * torch.exp(-((angles[:, 0] / 0.2) ** 2))
    return wi.numpy(), wo.numpy(), grey(values).numpy()


@pytest.mark.parametrize(("paradigm", "recipe"), [("meta", "full"), ("meta", "quick"), ("overfit", "quick")])
def test_fits_conserve_energy_where_asked(bright: tuple, paradigm: str, recipe: str) -> None:
    options = {"paradigm": paradigm, "recipe": recipe} | ({"steps": 200} if paradigm == "overfit" else {})
    fits = [metapp.fit("brdf", bright, conserve=conserve, **options) for conserve in (False, True)]
    most = [
        float(albedo(functools.partial(find_network(fit.parameters).evaluate, fit.parameters)).amax()) for fit in fits
    ]
    assert most[0] > 1.2
    assert 0.9 < most[1] <= 1.001


# Fits of instruments that do not reach grazing angles, beyond these


MEASURED, BEYOND = 60, (65, 82)  # degrees


def plastic(angles: Tensor, roughness: float, colour: tuple[float, float, float]) -> Tensor:
    """A colour under a clear coat: GGX with height-correlated masking, Fresnel after Schlick, F0 .04."""
    c = angle_cosines(angles)
    alpha = roughness**2
    density = alpha**2 / (math.pi * (c.half**2 * (alpha**2 - 1) + 1) ** 2)
    masked = [((1 + alpha**2 * (1 / z**2 - 1)).sqrt() - 1) / 2 for z in (c.incident, c.outgoing)]
    coat = density * (0.04 + 0.96 * (1 - c.difference) ** 5) / (4 * c.incident * c.outgoing * (1 + sum(masked)))
    return torch.tensor(colour) / math.pi + coat[..., None]


@pytest.mark.parametrize("roughness", [0.3, 0.8])
@pytest.mark.parametrize("colour", [(0.4, 0.2, 0.1), (0.05, 0.3, 0.1)])
def test_colours_go_on_beyond_what_was_measured(roughness: float, colour: tuple[float, float, float]) -> None:
    """Fits trained on complete materials alone are off by .3 to 1.1 in the channels' log ratios, green rims."""
    angles = quasirandom_angles(16_000).double()
    c = angle_cosines(angles)
    steepest = torch.minimum(c.incident, c.outgoing).clamp(-1, 1).arccos().rad2deg()
    values = plastic(angles, roughness, colour)
    wi, wo = rusinkiewicz_to_directions(angles)
    seen, beyond = steepest < MEASURED, (steepest > BEYOND[0]) & (steepest < BEYOND[1])
    fit = metapp.fit("brdf", (wi[seen].numpy(), wo[seen].numpy(), values[seen].numpy()))
    predicted = torch.as_tensor(fit(wi[beyond].numpy(), wo[beyond].numpy())).double()
    off = (predicted.clamp_min(1e-4) / values[beyond]).log()
    assert float((off - off.mean(1, keepdim=True)).abs().mean()) < 0.05
    assert abs(float(off.mean())) < 0.1


@pytest.mark.parametrize(
    ("bias", "words"), [(0.5, "reflects 2.04 of the light"), (50.0, "reflects more than 100 times the light")]
)
def test_fits_that_reflect_too_much_carry_a_warning(bias: float, words: str) -> None:
    presenter = presenter_of(Brdf(NBRDF_NETWORK))
    shapes = {"w1": (21, 6), "w2": (21, 21), "w3": (3, 21), "b1": (21, 1), "b2": (21, 1), "b3": (3, 1)}
    theta = {key: torch.zeros(shape) for key, shape in shapes.items()} | {"b3": torch.full((3, 1), bias)}
    task = Task("hot", {"angles": torch.rand(8, 3), "reflectance": torch.ones(8, 3)})
    assert words in str(presenter.remarks(theta, task)["note"])


@pytest.mark.parametrize("seed", range(20))
def test_unmeasured_highlights_are_reported(seed: int) -> None:
    """Scattered pairs of directions, whose mirror directions an instrument reaches or not."""
    rng = Generator().manual_seed(seed)
    count = int(torch.randint(8, 400, (), generator=rng))
    angles = torch.rand(2 * count, 3, generator=rng) * torch.tensor([1.2, 1.2, math.pi])
    far = angles.clone()
    far[:, 0] = math.radians(MIRROR_DEGREES) * 1.02 + far[:, 0]
    near = far.clone()
    one, share = int(torch.randint(count, (), generator=rng)), float(torch.rand((), generator=rng))
    near[one, 0] = math.radians(MIRROR_DEGREES) * share
    presenter = presenter_of(Brdf(NBRDF_NETWORK))
    theta = {key: value[0] for key, value in NBRDF_NETWORK.init(rng, 1).items()}

    def note(angles: Tensor) -> str:
        task = Task("paint", {"angles": angles, "reflectance": torch.ones(2 * count, 3)})
        return str(presenter.remarks(theta, task).get("note", ""))

    assert "highlight: no sample within 5 degrees of mirror directions" in note(far)
    assert "highlight: no sample" not in note(near)
    unseen = torch.cat([far[:count], near[:count]])  # held-out samples teach a fit nothing
    assert "highlight: no sample" in note(unseen)
