"""Gauss-Newton steps of several photographs against dense least squares, and derivatives through them."""

import math
from typing import Any

import pytest
import torch
from torch import Generator, Tensor

from metapp.apps.svbrdf_nonstationary.app import SvbrdfNonstationary
from metapp.apps.svbrdf_nonstationary.flashes import FLASH_NUMBERS, decode_flash, render_photos
from metapp.apps.svbrdf_nonstationary.maps import CHANNELS, decode_maps
from metapp.apps.svbrdf_nonstationary.multi_photo import newton
from metapp.apps.svbrdf_nonstationary.multi_photo.flash_gains import LIGHT_FLOOR
from metapp.apps.svbrdf_nonstationary.multi_photo.integrability import find_curl, find_slopes_of_curl
from metapp.apps.svbrdf_nonstationary.multi_photo.parallax import RELIEF_CHANNELS
from metapp.apps.svbrdf_nonstationary.multi_photo.photo_set_sight import CURL_ROUNDING, FALLOFF_WEIGHT, SeenPhotos
from metapp.apps.svbrdf_nonstationary.multi_photo.recipe import of_several
from metapp.learned_rules import rule_of
from metapp.learning.adjoint import DrawnBatch, Loss, learn_differentiably
from metapp.learning.recipe import Adam
from metapp.learning.task import Batch, Params
from tests.apps.multi_photo.test_several_photos import PLACES
from tests.recipe_apps import app_by_recipe

SIDE, COUNT = 4, 5
# steps of flashes are solved from all texels of maps this small, and slopes up to rounding
EXACT: dict[str, Any] = {"flash_stride": 1, "relative_residual": 1e-12}
SETTINGS = {"smoothing": 0.02, "prior": 1e-3, "flash": 1e-2, "curl": 0.05, "noise": 10.0}


@pytest.fixture
def app() -> SvbrdfNonstationary:
    return of_several(SIDE, SIDE)


def problem(off: float = 0.05, seed: int = 0) -> tuple[Params, Batch, Tensor]:
    """An initialisation near the maps of exact photographs, the batch, and these maps, in float64."""
    rng = Generator().manual_seed(seed)
    true = 0.4 * torch.randn(1, sum(CHANNELS), SIDE, SIDE, generator=rng, dtype=torch.float64)
    places = PLACES.double()[None, :, None].expand(1, COUNT, 2, 3)
    photos = render_photos(decode_maps(true), decode_flash(true.new_zeros(1, COUNT, FLASH_NUMBERS), places))
    maps = true + off * torch.randn(true.shape, generator=rng, dtype=torch.float64)
    flash = 0.2 * off * torch.randn(1, FLASH_NUMBERS, COUNT, generator=rng, dtype=torch.float64)
    prior = torch.cat([maps + 0.1, torch.zeros_like(maps)], 1)
    falloff = torch.full((1, 1), 2 * off, dtype=torch.float64)
    relief = photos.new_zeros(1, RELIEF_CHANNELS, SIDE, SIDE)
    seen = SeenPhotos(photos[:, 0], photos, torch.ones_like(photos[:, :, :1]), relief, places)
    return {"maps": maps, "flash": flash, "falloff": falloff, "prior": prior}, seen._asdict(), true


def settings(values: dict[str, float] = SETTINGS) -> Params:
    shapes = {"prior": (1, sum(CHANNELS))}
    return {
        key: torch.full(shapes.get(key, (1,)), math.log(value), dtype=torch.float64) for key, value in values.items()
    }


def test_changes_are_those_of_dense_least_squares() -> None:
    theta, batch, _ = problem()
    found = newton.gauss_newton_change(theta, batch, settings(), max_texel_change=sum(CHANNELS) * (1e6,), **EXACT)

    texels, flashes = slice(0, -FLASH_NUMBERS * COUNT - 1), slice(-FLASH_NUMBERS * COUNT - 1, -1)

    def logs(flat: Tensor) -> Tensor:
        maps, flash = flat[texels].view_as(theta["maps"]), flat[flashes].view_as(theta["flash"])
        lit = render_photos(decode_maps(maps), decode_flash(flash.mT, batch["places"], flat[-1:, None], camera="held"))
        return (lit + LIGHT_FLOOR).log().flatten()

    def dense(flash: Tensor, falloff: Tensor) -> tuple[Tensor, Tensor]:
        at = torch.cat([theta["maps"].flatten(), flash.flatten(), falloff.flatten()])
        rows, residuals = torch.func.jacfwd(logs)(at), logs(at) - (batch["photos"] + LIGHT_FLOOR).log().flatten()
        weight = (residuals.square() + SETTINGS["smoothing"] ** 2).rsqrt()
        off = (theta["maps"] - theta["prior"].chunk(2, 1)[0]).flatten()
        pull = 3 * SETTINGS["prior"] / (1 + off.square()).sqrt()
        curls = torch.func.jacfwd(lambda flat: find_curl(flat.view_as(theta["maps"])[:, :2]).flatten())(at[: len(off)])
        curl = curls @ at[: len(off)]
        curl_weight = 3 * SETTINGS["curl"] / (curl.square() + CURL_ROUNDING**2).sqrt()
        moved = torch.full((FLASH_NUMBERS, COUNT), 2 * SETTINGS["flash"]).to(flash)
        moved[3] = newton.GAIN_DAMPING
        falloff_weight = flash.new_tensor([6 * COUNT * FALLOFF_WEIGHT])
        moved = SIDE * SIDE * torch.cat([moved.flatten(), falloff_weight])
        matrix = rows.T @ (weight[:, None] * rows) + torch.cat([pull + newton.TEXEL_DAMPING, moved]).diag()
        moment = rows.T @ (weight * residuals) + torch.cat(
            [pull * off, moved * torch.cat([flash.flatten(), falloff.flatten()])]
        )
        both = torch.linalg.solve(matrix, moment)  # flashes are solved without curls
        matrix[texels, texels] += curls.T @ (curl_weight[:, None] * curls)
        moment[texels] += curls.T @ (curl_weight * curl)
        texels_alone = torch.linalg.solve(matrix[texels, texels], moment[texels])
        return both[texels.stop :], texels_alone.view_as(theta["maps"])

    # up to the error of central differences
    flash_change, _ = dense(theta["flash"], theta["falloff"])
    torch.testing.assert_close(
        torch.cat([found["flash"].flatten(), found["falloff"].flatten()]), flash_change, rtol=1e-3, atol=1e-6
    )
    _, texel_change = dense(theta["flash"] - found["flash"], theta["falloff"] - found["falloff"])
    torch.testing.assert_close(found["maps"], texel_change, rtol=1e-3, atol=1e-5)


def test_noise_free_photographs_are_reproduced_in_a_few_steps() -> None:
    theta, batch, true = problem(0.1)
    weak = settings(SETTINGS | {"prior": 1e-9, "curl": 1e-9})

    def worst(theta: Params) -> float:
        flashes = decode_flash(theta["flash"].mT, batch["places"], theta["falloff"], camera="held")
        lit = render_photos(decode_maps(theta["maps"]), flashes)
        return float((lit - batch["photos"]).abs().max())

    first = worst(theta)
    for _ in range(8):
        change = newton.gauss_newton_change(theta, batch, weak, **EXACT)
        theta = theta | {key: theta[key] - value for key, value in change.items()}
    assert worst(theta) < 0.01 * first
    assert float((theta["maps"][:, :2] - true[:, :2]).abs().median()) < 0.03


@pytest.mark.parametrize("noise", [0.003, 0.01, 0.03, 0.2])
def test_priors_weigh_more_where_photographs_are_noisier_than_weights_hold_for(noise: float) -> None:
    signs = torch.tensor([1.0, -1.0]).repeat(50)
    residual = (noise * signs).reshape(1, 10, 10).double()
    residual[0, 0] = 50.0  # outliers that do not count
    weight = torch.ones_like(residual)
    weight[0, 0] = 0.0
    before = settings(SETTINGS | {"noise": 0.01})
    after = newton._weigh_by_noise(weight, residual, before)
    growth = {key: (after[key] - before[key]).exp() for key in ("prior", "curl")}
    for found, power in ((growth["prior"][:, :2], 6), (growth["prior"][:, 2:], 4), (growth["curl"], 6)):
        torch.testing.assert_close(found, torch.full_like(found, 1 + (noise / 0.01) ** power), rtol=0.02, atol=0)
    assert all(torch.equal(after[key], before[key]) for key in ("smoothing", "flash"))


@pytest.mark.parametrize("true_falloff", [0.0, 1.5])
def test_fall_off_of_flashes_is_found(true_falloff: float) -> None:
    theta, batch, true = problem(0.1)
    flashes = decode_flash(torch.zeros_like(theta["flash"]).mT, batch["places"], true_falloff)
    batch["photos"] = render_photos(decode_maps(true), flashes)
    weak = settings(SETTINGS | {"prior": 1e-9})
    for _ in range(12):
        change = newton.gauss_newton_change(theta, batch, weak, **EXACT)
        theta = theta | {key: theta[key] - value for key, value in change.items()}
    assert float(theta["falloff"]) == pytest.approx(true_falloff, abs=0.15)


def test_derivatives_through_steps_are_those_of_finite_differences(app: SvbrdfNonstationary) -> None:
    theta, batch, true = problem()
    loss = newton.GaussNewton(lambda *_: DrawnBatch((), batch), app.loss, settings=app.sight.settings, **EXACT)
    rule = rule_of("gauss-newton")
    alpha = {
        key: value[:, None].double() for key, value in rule.initial_alpha(app, {"maps": true[0]}, 2, Adam(1.0)).items()
    }

    def left(*values: Tensor) -> Tensor:
        learned = rule.update_rule(dict(zip(alpha, values, strict=True)))
        moved = learn_differentiably(theta, learned, [batch, batch], loss, order=2)
        return (moved["maps"] - true).square().sum() + moved["flash"].square().sum()

    assert torch.autograd.gradcheck(left, [value.clone().requires_grad_() for value in alpha.values()], rtol=1e-3)


def test_curls_are_drawn_by_the_gradient_of_the_loss(app: SvbrdfNonstationary) -> None:
    """Where photographs and General's prior agree with the maps, curls are left."""
    theta, batch, _ = problem()
    theta |= {key: torch.zeros_like(theta[key]) for key in ("flash", "falloff")}
    batch["photos"] = render_photos(decode_maps(theta["maps"]), decode_flash(theta["flash"].mT, batch["places"]))
    theta["prior"][:, : sum(CHANNELS)] = theta["maps"]
    maps = theta["maps"].clone().requires_grad_()
    (gradient,) = torch.autograd.grad(app.loss(theta | {"maps": maps}, batch, settings()).sum(), maps)
    expected = torch.zeros_like(gradient)
    curl = find_curl(theta["maps"][:, :2])
    curl_weight = SETTINGS["curl"] / (curl.square() + CURL_ROUNDING**2).sqrt()
    expected[:, :2] = find_slopes_of_curl(curl_weight * curl) / COUNT
    torch.testing.assert_close(gradient, expected, rtol=1e-6, atol=1e-9)


def test_other_applications_are_refused_in_a_line(app: SvbrdfNonstationary) -> None:
    other = app_by_recipe("texture")
    with pytest.raises(ValueError, match="its part newton does not apply to texture: its fits are not maps"):
        rule_of("gauss-newton").check_app(other, {})
    plain = Loss(lambda *_: DrawnBatch((), {}), app.loss)
    assert isinstance(rule_of("gauss-newton").loss(app, plain), newton.GaussNewton)
