"""Gauss-Newton steps of several photographs: the part `newton` of rules.

Once the flashes are known, each texel is a problem of its own, as each point is in bundle adjustment once the cameras
are known (Triggs et al. 2000). So a step eliminates all texels by a Schur complement and solves one system for the 4 N
numbers of N flashes; then it solves one system for the 9 numbers of each texel.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor
from typing_extensions import override

from metapp.appearance.flash import Maps, render_maps, texel_positions
from metapp.apps.svbrdf_nonstationary.maps import (
    CHANNELS,
    CLIPPED_LINEAR_VALUE,
    FLASH_NUMBERS,
    ROUGHNESS_CHANNEL,
    decode_maps,
)
from metapp.apps.svbrdf_nonstationary.several.app import LIGHT_FLOOR, SeveralPhotos, decode_flashes
from metapp.learning.adjoint import AnyBatch, Loss
from metapp.learning.app import App
from metapp.learning.recipe import Adam
from metapp.learning.rules import append_axes
from metapp.learning.rules.rule import Part
from metapp.learning.task import Batch, Params

TEXEL_NUMBERS = sum(CHANNELS)
SHAPE_CHANNELS = 0, 1, ROUGHNESS_CHANNEL  # a texel's slopes and roughness, on which all three colour channels depend
FLASH_STRIDE = 4  # flashes are solved on every fourth row and column
TEXEL_DAMPING = 0.03  # added to the diagonal of a texel's normal equations (Levenberg), beside the prior's weights
# Weight of a flash's gain in the normal equations: the loss has none, and without it they could be singular.
GAIN_WEIGHT = 1e-4
# Soft bounds (tanh) of the change of each number of a texel in a step: first its two slopes, then the others
MAX_CHANGE = (0.3, 0.3, *(TEXEL_NUMBERS - 2) * (1.0,))
MAX_FLASH_CHANGE = 0.5  # hard bound of the change of each number of a flash in a step
DIFFERENCE_STEP = 1e-3  # step of central differences, in the numbers of texels and flashes


@dataclass(frozen=True)
class GaussNewton(Loss):
    """A loss of several photographs whose steps see Gauss-Newton's change in place of a gradient.

    Attributes:
        settings: a function of learned loss parameters and of a tensor [T, ...], which returns all loss parameters,
            [T, ...]; see :meth:`SeveralPhotos.settings`.
    """

    settings: Callable[[Params, Tensor], Params] = field(kw_only=True)

    @override
    def gradient(self, theta: Params, batch: AnyBatch, learned: Params, *, graph: bool) -> tuple[Params, Tensor]:
        """Return the change of maps and flashes in place of a gradient, and the losses [T]."""
        with torch.set_grad_enabled(graph):
            change = gauss_newton_change(theta, batch, self.settings(learned, theta["maps"]))
        with torch.no_grad():
            losses = self.value(theta, batch, learned)
        return change, losses


class Newton(Part):
    """The part of a rule that takes Gauss-Newton steps times a learned length, whose logs are `length` [steps]."""

    name = "newton"
    is_rate = True

    @override
    def refusal(self, app: App, theta: Params) -> str:
        return "" if isinstance(app, SeveralPhotos) else "its fits are not maps under flashes of several photographs"

    @override
    def initial(self, app: App, theta: Params, steps: int, adam: Adam) -> Params:
        """Return logs of lengths, `length` [steps], that are 0, so that steps are whole."""
        return {"length": torch.zeros(steps)}

    @override
    def loss(self, app: App, loss: Loss) -> Loss:
        """Return the loss whose gradient is the Gauss-Newton step."""
        assert isinstance(app, SeveralPhotos)
        return GaussNewton(loss.draw, loss.value, loss.shared, settings=app.settings)

    @override
    def updates(self, alpha: Params, updates: Params) -> Params:
        """Multiply changes by the learned lengths."""
        return {key: append_axes(torch.exp(alpha["length"]), change) * change for key, change in updates.items()}


def gauss_newton_change(
    theta: Params, batch: Batch, settings: Params, *, max_texel_change: Sequence[float] = MAX_CHANGE
) -> Params:
    """Return the Gauss-Newton step of `maps` [T, 9, H, W] and `flash` [T, 4, N], which is to be subtracted.

    The loss is not of squares but of rounded |differences|, so each step solves a reweighted least-squares problem. Its
    gradient is the gradient of :meth:`SeveralPhotos.loss` times 3 N, for N photographs: at each texel the loss takes
    the mean of 3 N differences, and least squares take their sum.

    Args:
        theta: `maps`, `flash` and `prior`.
        batch: `photos` and `places`.
        settings: all loss parameters, [T, ...].
        max_texel_change: the largest change of each of the nine numbers of a texel.
    """
    maps, flash, prior, photos = theta["maps"], theta["flash"], theta["prior"], batch["photos"]
    texels = texel_positions(*maps.shape[-2:], dtype=maps.dtype, device=maps.device)
    coarse_maps, coarse_photos, coarse_prior, coarse_texels = (
        picture[..., FLASH_STRIDE // 2 :: FLASH_STRIDE, FLASH_STRIDE // 2 :: FLASH_STRIDE]
        for picture in (maps, photos, prior, texels)
    )
    flash_change = _solve_flashes(
        coarse_maps, flash, coarse_photos, batch["places"], coarse_prior, coarse_texels, settings
    )
    jacobian, weight, residual = _linearise(maps, flash - flash_change, photos, batch["places"], texels, settings)
    matrix, right_side = _build_normal_equations(jacobian, weight, residual, maps, prior, settings)
    change = _solve(matrix, right_side[..., None])[..., 0].unflatten(1, maps.shape[-2:]).permute(0, 3, 1, 2)
    max_change = maps.new_tensor(max_texel_change)[:, None, None]
    return {"maps": max_change * torch.tanh(change / max_change), "flash": flash_change}


def _linearise(
    maps: Tensor, flash: Tensor, photos: Tensor, places: Tensor, texels: Tensor, settings: Params
) -> tuple[Tensor, Tensor, Tensor]:
    """Linearise log radiance in the numbers of P texels, for N photographs with three colour channels each.

    Returns:
        The Jacobian [T, P, 3N, 9], and the weights and residuals of least squares, [T, P, 3N].
    """
    # Each channel of a colour depends on one number alone, so that one pair of evaluations differentiates all of them.
    (diffuse, specular), increased, decreased = (
        decode_maps(maps + change)[:2] for change in (0, DIFFERENCE_STEP, -DIFFERENCE_STEP)
    )
    diffuse_derivative, specular_derivative = (
        (upper - lower) / (2 * DIFFERENCE_STEP) for upper, lower in zip(increased, decreased, strict=True)
    )
    lobes = _render_lobes(maps, flash, places, texels)
    diffuse_lobe, specular_lobe = lobes.split(1, 2)
    by_slope_x, by_slope_y, by_roughness = (
        _combine_lobes(derivative, diffuse, specular)[:, :, None]
        for derivative in _differentiate(lambda raw: _render_lobes(raw, flash, places, texels), maps, SHAPE_CHANNELS)
    )
    # A channel of the photograph depends on the same channel of the colours alone: derivatives are a diagonal matrix.
    identity = torch.eye(3, device=maps.device)[:, :, None, None]
    by_diffuse = diffuse_lobe * ((1 - specular) * diffuse_derivative)[:, None]
    by_specular = (specular_lobe - diffuse_lobe * diffuse[:, None]) * specular_derivative[:, None]
    by_diffuse, by_specular = (derivative[:, :, None] * identity for derivative in (by_diffuse, by_specular))
    radiance = _combine_lobes(lobes, diffuse, specular) + LIGHT_FLOOR
    jacobian = torch.cat([by_slope_x, by_slope_y, by_diffuse, by_roughness, by_specular], 2) / radiance[:, :, None]
    jacobian = jacobian.permute(0, 4, 5, 1, 3, 2).reshape(len(maps), -1, 3 * photos.shape[1], TEXEL_NUMBERS)
    residual = radiance.log() - (photos + LIGHT_FLOOR).log()
    rounding = append_axes(settings["smoothing"].exp(), residual)
    weight = (residual.square() + rounding * rounding).rsqrt()
    # Where a photograph clips, it is a lower bound of radiance: brighter renderings agree with it.
    weight = torch.where((photos > CLIPPED_LINEAR_VALUE) & (residual > 0), 0, weight)
    weight, residual = (values.flatten(1, 2).flatten(2).mT.contiguous() for values in (weight, residual))
    return jacobian, weight, residual


def _render_lobes(maps: Tensor, flash: Tensor, places: Tensor, texels: Tensor) -> Tensor:
    """Return the radiance of the two lobes of reflection, [T, N, 2, h, w].

    The first is the radiance of a diffuse surface of albedo 1, the second the radiance of a glossy surface of specular
    colour 1; :func:`_combine_lobes` gives them their colours.
    """
    flashes, material = decode_flashes(flash, places), decode_maps(maps)
    white = maps.new_tensor([1.0, 0.0])[:, None, None]
    surface = Maps(white, white.flip(0), material.roughness[:, None], material.normal[:, None])
    return render_maps(surface, texels, flashes.place, flashes.eye, intensity=flashes.gain)


def _combine_lobes(lobes: Tensor, diffuse: Tensor, specular: Tensor) -> Tensor:
    """Return the radiance [T, N, 3, h, w] of a surface from its lobes and colours.

    Args:
        lobes: the lobes of :func:`_render_lobes`, or their derivatives by something that moves no colour,
            [T, N, 2, h, w].
        diffuse: the diffuse colour, [T, 3, h, w].
        specular: the specular colour, [T, 3, h, w].
    """
    diffuse_lobe, specular_lobe = lobes.split(1, 2)
    radiance: Tensor = diffuse_lobe * (diffuse * (1 - specular))[:, None] + specular_lobe * specular[:, None]
    return radiance


def _differentiate(function: Callable[[Tensor], Tensor], values: Tensor, channels: Iterable[int]) -> list[Tensor]:
    """Differentiate a function of a tensor [T, K, ...] by the given ones of its K channels, by central differences.

    Forward differentiation by torch is as fast, but its first use imports for more than a second.
    """
    results = []
    for channel in channels:
        step = torch.zeros_like(values)
        step[:, channel] = DIFFERENCE_STEP
        results.append((function(values + step) - function(values - step)) / (2 * DIFFERENCE_STEP))
    return results


def _build_normal_equations(
    jacobian: Tensor, weight: Tensor, residual: Tensor, maps: Tensor, prior: Tensor, settings: Params
) -> tuple[Tensor, Tensor]:
    """Return the matrix [T, P, 9, 9] and the right side [T, P, 9] of the normal equations of each texel.

    Args:
        jacobian, weight, residual: the linearised photographs that :func:`_linearise` returns.
        maps: the unbounded numbers of P texels, [T, 9, h, w].
        prior: the numbers that the prior expects, and the logs of the scales by which they may be off, [T, 18, h, w].
        settings: all loss parameters, [T, ...].
    """
    mean, log_scale = prior.chunk(2, 1)
    precision = torch.exp(-2 * log_scale)
    displacement = maps - mean
    reweighting = (1 + displacement.square() * precision).sqrt()  # the prior's loss is of rounded |displacements|, too
    # The loss divides residuals by 3 N and the prior by N, for N photographs; residuals are a plain sum here.
    prior_weight = 3 * settings["prior"].exp()[:, :, None, None] * precision / reweighting
    prior_weight, displacement = (values.flatten(2).mT for values in (prior_weight, displacement))
    weighted = (jacobian * weight[..., None]).mT
    matrix = weighted @ jacobian + torch.diag_embed(prior_weight + TEXEL_DAMPING)
    return matrix, (weighted @ residual[..., None])[..., 0] + prior_weight * displacement


def _solve_flashes(
    maps: Tensor, flash: Tensor, photos: Tensor, places: Tensor, prior: Tensor, texels: Tensor, settings: Params
) -> Tensor:
    """Return the Gauss-Newton step of flashes, [T, 4, N], by the Schur complement: numbers of texels are eliminated."""
    count = photos.shape[1]
    jacobian, weight, residual = _linearise(maps, flash, photos, places, texels, settings)
    matrix, right_side = _build_normal_equations(jacobian, weight, residual, maps, prior, settings)
    diffuse, specular, *_ = decode_maps(maps)

    def render_logs(flash: Tensor) -> Tensor:
        return (_combine_lobes(_render_lobes(maps, flash, places, texels), diffuse, specular) + LIGHT_FLOOR).log()

    derivatives = [derivative.flatten(3) for derivative in _differentiate(render_logs, flash, range(FLASH_NUMBERS))]
    identity = torch.eye(count, dtype=maps.dtype, device=maps.device)  # each photograph depends on one flash
    flash_jacobian = torch.einsum("nm,tncpf->tpncmf", identity, torch.stack(derivatives, -1)).flatten(4).flatten(2, 3)
    weighted = (flash_jacobian * weight[..., None]).mT
    coupling = jacobian.mT @ weighted.mT
    eliminated = _solve(matrix, torch.cat([coupling, right_side[..., None]], -1))
    flash_matrix = (weighted @ flash_jacobian - coupling.mT @ eliminated[..., :-1]).sum(1)
    flash_right_side = ((weighted @ residual[..., None])[..., 0] - (coupling.mT @ eliminated[..., -1:])[..., 0]).sum(1)
    # Flashes have a prior, too, which draws each number to 0, the measured flash. At a texel the loss has the mean of
    # squares over the three numbers of a position and N photographs: times 3 N, its gradient is 2 * weight * number.
    is_position = torch.arange(FLASH_NUMBERS, device=maps.device) < FLASH_NUMBERS - 1
    texel_weight = torch.where(is_position, 2 * settings["flash"].exp()[:, None], GAIN_WEIGHT)
    prior_weight = residual.shape[1] * texel_weight.repeat(1, count)
    flash_matrix = flash_matrix + torch.diag_embed(prior_weight)
    flash_right_side = flash_right_side + prior_weight * flash.mT.flatten(1)
    change = torch.linalg.solve(flash_matrix.double(), flash_right_side.double())
    change = change.to(maps).reshape(-1, count, FLASH_NUMBERS)
    bounded: Tensor = change.mT.clamp(-MAX_FLASH_CHANGE, MAX_FLASH_CHANGE)
    return bounded


def _solve(matrix: Tensor, right_sides: Tensor) -> Tensor:
    """Solve linear equations with matrices [T, P, 9, 9] and right sides [T, P, 9, K] by Cholesky decomposition."""
    return torch.cholesky_solve(right_sides, torch.linalg.cholesky(matrix))
